"""The command line, chaincrane: its commands, in the order of its help.

A command's module is imported when it is asked for: all of them take a third of a second.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from inspect import getdoc
from pathlib import Path
from typing import Any, NoReturn

from . import shipped
from .errors import UserError
from .options import add_fmus
from .places import hindrance

# Each but build is a module of its name: the line of the help, which is the first of its command's
# own, and an example.
COMMANDS = {
    "build": ("Build the FMUs, or copy those that came.", "chaincrane build"),
    "run": (
        "Run scenarios: results as CSV, a table of differences, a picture.",
        "chaincrane run paper_heavy",
    ),
    "report": (
        "Write a scenario's runs as one HTML file: the crane moving, curves, differences,"
        " settings.",
        "chaincrane report paper_light",
    ),
    "figures": (
        "Draw the paper's Figs. 4 to 7 from the FMUs, with the comparison in numbers.",
        "chaincrane figures --out figures",
    ),
    "antisway": (
        "Move the crane by 1 m in closed loop: metrics, a picture, the SSP package.",
        "chaincrane antisway --payload 0.07",
    ),
    "converge": (
        "Estimate the time and mesh errors of a scenario's runs: tables, CSV, a picture.",
        "chaincrane converge paper_heavy --run nonlinear",
    ),
    "sweep": (
        "Run a scenario, or the closed loop, for many values of what varies: dataset, CSV,"
        " picture.",
        "chaincrane sweep paper_heavy --vary payload.mass=0.05:0.5:50 --vary chain.elements=2,5,10",
    ),
    "fit": (
        "Fit parameters of the crane to measured signals: values, standard errors, a picture.",
        "chaincrane fit paper_heavy measured.csv --fit payload.mass=0.3 --shift",
    ),
    "check": (
        "Compare every run with its frozen reference; 1 where one differs or cannot be compared.",
        "chaincrane check --fmu crane_nl_native.fmu",
    ),
    "export": (
        "Write runs in the form of the FMI cross-check rules: FMU, inputs, reference, options.",
        "chaincrane export paper_heavy --out crosscheck",
    ),
    "study": (
        "Run a study from the FMUs: tables and a picture. The study: observer, a minute or two.",
        "chaincrane study observer --out docs",
    ),
}


class Parser(argparse.ArgumentParser):
    """A command line's grammar whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        """End with the message and where help is."""
        self.exit(2, f"chaincrane: {message}; see {self.prog} --help\n")


class Versions(argparse.Action):
    """The option that says the versions of what decides a result."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        """Say them, and end."""
        from importlib import metadata

        ours, fmpy = metadata.version("chaincrane"), metadata.version("fmpy")
        print(f"chaincrane {ours} (FMPy {fmpy}, Python {platform.python_version()})")
        parser.exit()


def parser(asked: str | None = None) -> argparse.ArgumentParser:
    """The command line's grammar, with the options of the command that is ``asked`` for."""
    top = Parser(
        prog="chaincrane",
        description="Drive the cranes' FMUs with FMPy: compare, draw, check.",
        epilog="examples:\n  chaincrane build\n  chaincrane run paper_heavy\n  chaincrane figures\n"
        "  chaincrane check --fmu some_other_crane.fmu --model crane_nl",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    told = "show program's version number and exit"
    top.add_argument("--version", action=Versions, nargs=0, help=told)
    commands = top.add_subparsers(metavar="COMMAND", required=True)
    for name, (line, example) in COMMANDS.items():
        sub = commands.add_parser(
            name,
            help=line,
            epilog=f"example: {example}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        if name == asked:
            module = command_module(name)
            sub.description = getdoc(module.command)
            sub.set_defaults(action=module.command)
            add_fmus(sub)
            module.add_options(sub)
    return top


def command_module(name: str) -> Any:
    """The module of a command: its function command, and add_options for its options."""
    return import_module(f".{name}_command", __package__)


@contextmanager
def own_temporary_folder() -> Iterator[None]:
    """A temporary folder for this command and its workers, gone with it.

    A worker that is stopped half-way leaves the FMU that it unpacked.
    """
    before = os.environ.get("TMPDIR")
    with tempfile.TemporaryDirectory(prefix="chaincrane-", ignore_cleanup_errors=True) as folder:
        tempfile.tempdir = os.environ["TMPDIR"] = folder
        try:
            yield
        finally:
            tempfile.tempdir = None
            if before is None:
                del os.environ["TMPDIR"]
            else:
                os.environ["TMPDIR"] = before


def check_places(options: argparse.Namespace) -> None:
    """Where a command is to write it can: said before its work, not after. Raises UserError."""
    given = vars(options)
    folders = {"out": given["out"] or Path("results")} if "out" in given else {}
    for option in ("junit", "json"):
        file = given.get(option)
        if file is not None:
            if file.is_dir():
                raise UserError(f"--{option} {file}: is a folder")
            folders[option] = file.parent
    for option, folder in folders.items():
        reason = hindrance(folder)
        if reason is not None:
            raise UserError(f"--{option} {given[option] or folder}: {reason}")


def main(arguments: list[str] | None = None) -> int:
    """Entry point of the command; errors that a user can mend are one line."""
    given = sys.argv[1:] if arguments is None else arguments
    if given[:1] == ["build"]:  # it alone needs the models, and what makes FMUs of them
        from chaincrane_builder import command

        return command.main(given[1:], "chaincrane build", shipped.FMUS)
    asked = given[0] if given and given[0] in COMMANDS else None
    options = parser(asked).parse_args(given)
    try:
        check_places(options)
        with own_temporary_folder():
            return int(options.action(options))
    except UserError as error:
        print(f"chaincrane: {error}", file=sys.stderr)
    except BrokenPipeError:  # the reader has seen enough: chaincrane ... | head
        sys.stdout = None
        return 0
    except OSError as error:
        reason = f"{error.filename}: {error.strerror}" if error.filename else str(error)
        print(f"chaincrane: {reason}", file=sys.stderr)
    except KeyboardInterrupt:
        print("chaincrane: stopped", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
