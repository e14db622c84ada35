"""Compiles the driver's loop over communication steps, native/stepper.c, which knows no crane."""

from __future__ import annotations

import sys
from pathlib import Path

from .compile_c import NATIVE, libraries, library_for_host

NAME = "stepper"


def _sources() -> dict[str, bytes]:
    return {f"{NAME}.c": (NATIVE / f"{NAME}.c").read_bytes()}


def for_host() -> bytes:
    """This host's library. Raises CalledProcessError, FileNotFoundError without a compiler."""
    return library_for_host(_sources(), NAME)


def main(folder: Path) -> None:
    """Write the library for every platform below ``folder``, by FMI's names of them."""
    for path, content in libraries(_sources(), NAME).items():
        file = folder / NAME / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
