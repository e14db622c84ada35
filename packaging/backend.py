"""The build backend: setuptools, on a copy of the sources, with built FMUs in a wheel.

A wheel carries what a checkout has beside its packages: scenarios, the FMUs' sources, the FMUs
themselves and the stepper, so that its user needs no compiler. The copy leaves the checkout as it
was: it may be read-only.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from setuptools import build_meta

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parent.parent
# an editable installation is setuptools' own: it reads the checkout, and writes beside it
get_requires_for_build_editable = build_meta.get_requires_for_build_editable
prepare_metadata_for_build_editable = build_meta.prepare_metadata_for_build_editable
build_editable = build_meta.build_editable
LEFT_BEHIND = (".*", "__pycache__", "*.egg-info", "*.fmu", "*.ssp", "build", "dist", "results")


def get_requires_for_build_sdist(settings: dict[str, Any] | None = None) -> list[str]:
    """A source distribution needs nothing more."""
    return []


def get_requires_for_build_wheel(settings: dict[str, Any] | None = None) -> list[str]:
    """To build FMUs: what chaincrane needs, and a compiler."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return [*project["dependencies"], *project["optional-dependencies"]["build"]]


def build_sdist(folder: str, settings: dict[str, Any] | None = None) -> str:
    """Write a source distribution into ``folder``; its name."""
    folder = os.path.abspath(folder)
    with _copy_of_the_sources():
        return str(build_meta.build_sdist(folder, settings))


def build_wheel(
    folder: str, settings: dict[str, Any] | None = None, metadata: str | None = None
) -> str:
    """Write a wheel into ``folder``; its name."""
    folder = os.path.abspath(folder)
    with _copy_of_the_sources() as copy:
        # where there is no home, the compiler's cache is in the temporary folder: it goes, too
        environment = {**os.environ, "TMPDIR": str(copy.parent)}
        builder = [sys.executable, "build_fmu.py", "--dest"]
        fmus = copy / "chaincrane_driver" / "shipped" / "fmus"
        for native in ([], ["--native"]):
            subprocess.run([*builder, str(fmus), *native], check=True, env=environment)
        stepper = [
            sys.executable,
            "-m",
            "chaincrane_builder.stepper",
            "../chaincrane_driver/shipped",
        ]
        subprocess.run(stepper, check=True, cwd=copy / "fmu_src", env=environment)
        shutil.copytree(copy / "scenarios", fmus.parent / "scenarios")
        inside = copy / "fmu_src" / "chaincrane_builder"
        sources = shutil.ignore_patterns("chaincrane_builder", "__pycache__")
        shutil.copytree(copy / "fmu_src", copy / "sources", ignore=sources)
        shutil.move(copy / "sources", inside / "fmu_src")
        shutil.copy(copy / "LICENSE", inside)
        return str(build_meta.build_wheel(folder, settings))


@contextmanager
def _copy_of_the_sources() -> Iterator[Path]:
    """A copy of the sources as the working folder, gone afterwards."""
    before = Path.cwd()
    with TemporaryDirectory(ignore_cleanup_errors=True) as scratch:
        copy = Path(scratch, "chaincrane")
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(*LEFT_BEHIND))
        for path in [copy, *copy.rglob("*")]:
            path.chmod(path.stat().st_mode | 0o200)  # of a read-only checkout
        os.chdir(copy)
        try:
            yield copy
        finally:
            os.chdir(before)
