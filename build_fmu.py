#!/usr/bin/env python3
"""Build the cranes' FMUs, native twins, observer and controller, and check each with FMPy."""

from __future__ import annotations

import argparse
import subprocess
import sys
import zipfile
from pathlib import Path, PurePosixPath

sys.path.insert(0, str(Path(__file__).resolve().parent / "fmu_src"))

from chaincrane_builder.fmus import MODELS, NATIVE_MODELS
from chaincrane_builder.pack import build


def platforms(fmu: Path) -> str:
    """For which platforms an FMU has compiled C of ours."""
    folder = "binaries" if fmu.stem in NATIVE_MODELS else "resources/native"
    with zipfile.ZipFile(fmu) as archive:
        names = [PurePosixPath(name) for name in archive.namelist()]
    found = [name.parent.name for name in names if str(name.parent.parent) == folder]
    return ", ".join(found) or "none"


def main(arguments: list[str] | None = None) -> int:
    """Build what the command line asks for; 0 where FMPy finds no problem."""
    parser = argparse.ArgumentParser(
        description="Build the FMUs and validate them with FMPy.",
        epilog="examples:  python build_fmu.py    python build_fmu.py --dest out crane_nl"
        "    python build_fmu.py --native",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    every = MODELS + NATIVE_MODELS
    parser.add_argument("models", nargs="*", metavar="MODEL", help=f"{', '.join(every)}")
    parser.add_argument("--native", action="store_true", help=f"build {', '.join(NATIVE_MODELS)}")
    parser.add_argument("--dest", type=Path, default=Path(), help="folder for the FMUs (this one)")
    options = parser.parse_args(arguments)
    unknown = sorted(set(options.models) - set(every))
    if unknown:
        parser.error(f"no such model: {', '.join(unknown)}; there are {', '.join(every)}")
    from fmpy.validation import validate_fmu

    failed = False
    for model in options.models or (NATIVE_MODELS if options.native else MODELS):
        try:
            fmu = build(model, options.dest)
        except subprocess.CalledProcessError as error:
            print(f"{model}: the C sources do not compile:\n{error.stderr}", file=sys.stderr)
            return 1
        problems = validate_fmu(str(fmu))
        for problem in problems:
            print(f"{fmu}: {problem}", file=sys.stderr)
        failed = failed or bool(problems)
        verdict = "INVALID" if problems else "valid"
        print(f"{fmu}: {verdict}, {fmu.stat().st_size // 1024} kB; C for: {platforms(fmu)}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
