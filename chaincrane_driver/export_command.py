"""chaincrane export."""

from __future__ import annotations

import argparse
from pathlib import Path

from . import crosscheck, scenario, shipped
from .options import add_run, add_scenario


def command(options: argparse.Namespace) -> int:
    """Write runs in the form of the FMI cross-check rules: FMU, inputs, reference, options.

    That form has no start values, so only runs that start with the FMU's own are written.
    """
    scenarios = [scenario.load(folder) for folder in options.scenario]
    runs = [(one, run) for one in scenarios for run in one.named(options.run)]
    written = []
    for one, run in runs:
        fmu = shipped.fmu(options.fmus, run.fmu)
        if not options.run and crosscheck.default_starts(one, run, fmu):
            print(f"left out: {one.name}, {run.name}: it has start values of its own")
        else:
            written += crosscheck.export(one, run, fmu, options.out)
    for folder in written:
        print(f"written: {folder}")
    return 0 if written else 1


def add_options(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    add_scenario(parser, "+")
    add_run(parser)
    parser.add_argument(
        "--out", type=Path, default=Path("crosscheck"), metavar="DIR", help="folder (crosscheck)"
    )
