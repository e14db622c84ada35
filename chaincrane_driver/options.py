"""Options that several commands have."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

from . import shipped


def add_scenario(parser: ArgumentParser, count: str | None = None) -> None:
    """The argument that says which scenario; ``count``: as argparse's nargs."""
    text = "a scenario's folder, or the name of one of ours"
    text += " (all of --scenarios)" if count == "*" else ""
    parser.add_argument("scenario", type=Path, nargs=count, help=text)


def add_run(parser: ArgumentParser) -> None:
    """The option that chooses among a scenario's runs."""
    parser.add_argument(
        "--run", action="append", default=[], metavar="NAME", help="a run of the scenario (all)"
    )


def add_scenarios(parser: ArgumentParser) -> None:
    """The option that says where scenarios are."""
    parser.add_argument(
        "--scenarios",
        type=Path,
        default=shipped.scenarios(),
        metavar="DIR",
        help="where the scenarios are (scenarios, else those that came with chaincrane)",
    )


def add_fmus(parser: ArgumentParser) -> None:
    """The option that says where FMUs are."""
    parser.add_argument(
        "--fmus",
        type=Path,
        default=shipped.WORKING_FOLDER,
        metavar="DIR",
        help="where the FMUs are (here, else those that came with chaincrane)",
    )


def add_out(parser: ArgumentParser, folder: str) -> None:
    """The option that says where results go, in ``folder`` if nothing is said."""
    parser.add_argument(
        "--out",
        type=Path,
        default=Path(folder),
        metavar="DIR",
        help=f"folder for the results ({folder})",
    )
