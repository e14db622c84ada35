"""Is an FMU what the sources beside this package say? Its own list of hashes tells."""

from __future__ import annotations

import sys
import zipfile
from collections.abc import Iterable
from hashlib import sha256
from pathlib import Path

from .shipped import CHECKOUT

LIST = "documentation/sources.sha256"  # in the FMU; as sha256sum writes it


def changed_sources(fmu: Path, checkout: Path = CHECKOUT) -> list[str]:
    """Files of the checkout that are not those an FMU was built from, or are no longer there.

    Empty where there are no sources here to compare with, or the FMU does not list its own.
    """
    try:
        with zipfile.ZipFile(fmu) as archive:
            lines = archive.read(LIST).decode().splitlines()
    except (OSError, KeyError, zipfile.BadZipFile):
        return []
    listed = {name: digest for digest, _, name in (line.partition("  ") for line in lines)}
    if not any((checkout / name).exists() for name in listed):
        return []
    return [name for name, digest in listed.items() if _digest(checkout / name) != digest]


def _digest(file: Path) -> str | None:
    try:
        return sha256(file.read_bytes()).hexdigest()
    except OSError:
        return None


def say_if_stale(fmus: Iterable[Path]) -> bool:
    """Say on a line of stderr which FMUs are not what the sources here would make; True if any."""
    found = False
    for fmu in dict.fromkeys(fmus):
        changed = changed_sources(fmu)
        if changed:
            more = f" and {len(changed) - 1} more" if len(changed) > 1 else ""
            what = f"{changed[0]}{more} changed since: build it anew"
            print(f"chaincrane: {fmu} is stale: {what}", file=sys.stderr)
            found = True
    return found
