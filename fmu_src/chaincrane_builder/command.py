"""The command that builds FMUs: build_fmu.py in a checkout, and chaincrane build."""

from __future__ import annotations

import argparse
import errno
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path, PurePosixPath
from typing import NoReturn

from .compile_c import has_cc, has_zig
from .fmus import MODELS, NATIVE_MODELS
from .pack import build

# What zig or a compiler says where the machine, and not the C file, is at fault.
OF_THE_MACHINE = {
    "NoSpaceLeft": "no space left on the disk",
    "No space left": "no space left on the disk",
    "AccessDenied": "a folder cannot be written",
    "Permission denied": "a folder cannot be written",
    "ReadOnlyFileSystem": "a folder cannot be written",
    "Read-only file system": "a folder cannot be written",
}


def platforms(fmu: Path) -> list[str]:
    """FMI's names of the platforms that an FMU runs on."""
    with zipfile.ZipFile(fmu) as archive:
        names = [PurePosixPath(name).parts for name in archive.namelist()]
    return sorted({parts[1] for parts in names if parts[0] == "binaries" and len(parts) > 2})


def main(
    arguments: list[str] | None = None,
    program: str = "python build_fmu.py",
    ready: Path | None = None,
) -> int:
    """Build what the command line asks for; 0 where FMPy finds no problem.

    ``ready``: a folder of FMUs that were built already, which are copied.
    """
    options = _options(arguments, program)
    before = os.environ.get("TMPDIR")
    code = 2
    try:
        with tempfile.TemporaryDirectory(
            prefix="chaincrane-", ignore_cleanup_errors=True
        ) as folder:
            tempfile.tempdir = os.environ["TMPDIR"] = folder  # no litter, whatever ends this
            code = _build_all(options, ready)
    except KeyboardInterrupt:
        print("chaincrane: stopped", file=sys.stderr)
    except subprocess.CalledProcessError as error:
        code = _say_compile_error(error)
    except (FileExistsError, NotADirectoryError):
        print(f"chaincrane: --dest {options.dest}: is not a folder", file=sys.stderr)
    except OSError as error:
        where = error.filename or f"cannot build into {options.dest.resolve()}"
        print(f"chaincrane: {where}: {error.strerror or error}", file=sys.stderr)
    finally:
        tempfile.tempdir = None
        if before is None:
            os.environ.pop("TMPDIR", None)
        else:
            os.environ["TMPDIR"] = before
    return code


class _Parser(argparse.ArgumentParser):
    """A command line's grammar whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        """End with the message and where help is."""
        self.exit(2, f"chaincrane: {message}; see {self.prog} --help\n")


def _options(arguments: list[str] | None, program: str) -> argparse.Namespace:
    parser = _Parser(
        prog=program,
        description="Build the cranes' FMUs, and validate them with FMPy.",
        epilog=f"examples:  {program}    {program} --dest out crane_nl    {program} --native",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    every = MODELS + NATIVE_MODELS
    parser.add_argument("models", nargs="*", metavar="MODEL", help=f"{', '.join(every)}")
    parser.add_argument("--native", action="store_true", help=f"build {', '.join(NATIVE_MODELS)}")
    parser.add_argument("--dest", type=Path, default=Path(), help="folder for the FMUs (this one)")
    parser.add_argument(
        "--compile", action="store_true", help="build from the sources, even where FMUs are ready"
    )
    options = parser.parse_args(arguments)
    unknown = sorted(set(options.models) - set(every))
    if unknown:
        parser.error(f"no such model: {', '.join(unknown)}; there are {', '.join(every)}")
    if not options.models:
        options.models = NATIVE_MODELS if options.native else MODELS
    return options


def _build_all(options: argparse.Namespace, ready: Path | None) -> int:
    options.dest.mkdir(parents=True, exist_ok=True)
    if not os.access(options.dest, os.W_OK):
        raise PermissionError(errno.EACCES, "cannot be written", str(options.dest))
    count, failed = len(options.models), False
    for number, model in enumerate(options.models, 1):
        fmu = None if ready is None or options.compile else ready / f"{model}.fmu"

        def say(text: str, head: str = f"{model} ({number} of {count})") -> None:
            print(f"{head}: {text} ...", file=sys.stderr, flush=True)

        if fmu is not None and fmu.exists():
            say(f"copying from {fmu.parent}")
            fmu = _copy(fmu, options.dest)
        elif model in NATIVE_MODELS and not (has_zig() or has_cc()):
            print(f"chaincrane: {model}: no C compiler: pip install ziglang", file=sys.stderr)
            return 2
        else:
            fmu = build(model, options.dest, say=say)
        say("validating")
        problems = _problems(fmu)
        for problem in problems:
            print(f"{fmu}: {problem}", file=sys.stderr)
        failed = failed or bool(problems)
        verdict = "INVALID" if problems else "valid"
        where = ", ".join(platforms(fmu))
        print(f"{fmu}: {verdict}, {fmu.stat().st_size // 1024} kB, runs on {where}", flush=True)
    return 1 if failed else 0


def _copy(fmu: Path, dest: Path) -> Path:
    partial = dest / f"{fmu.stem}.part"
    try:
        shutil.copyfile(fmu, partial)
        return partial.replace(dest / fmu.name)
    finally:
        partial.unlink(missing_ok=True)


def _problems(fmu: Path) -> list[str]:
    """What FMPy finds wrong with an FMU."""
    from fmpy.validation import validate_fmu

    return [str(problem) for problem in validate_fmu(str(fmu))]


def _say_compile_error(error: subprocess.CalledProcessError) -> int:
    text = error.stderr or ""
    for sign, cause in OF_THE_MACHINE.items():
        if sign in text:
            line = next(line for line in text.splitlines() if sign in line).strip()
            print(f"chaincrane: the compiler cannot work: {cause} ({line})", file=sys.stderr)
            return 2
    print(f"chaincrane: the C sources do not compile:\n{text}", file=sys.stderr)
    return 1
