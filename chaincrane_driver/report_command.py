"""chaincrane report."""

from __future__ import annotations

import argparse
from dataclasses import replace

from . import report, scenario
from .options import add_out, add_run, add_scenario
from .run_command import checked_units, run_all


def command(options: argparse.Namespace) -> int:
    """Write a scenario's runs as one HTML file: the crane moving, curves, differences, settings.

    It opens in any browser, from disk. chaincrane antisway writes one of the closed loop.
    """
    for folder in options.scenario:
        one = scenario.load(folder)
        one = replace(one, runs=one.named(options.run))
        results, units = run_all(one, options.fmus), checked_units(one, options.fmus)
        told = report.of_scenario(one, results, units, options.fmus)
        path = told.write(options.out / f"{one.name}.html")
        print(f"written: {path}, {path.stat().st_size // 1024} kB")
    return 0


def add_options(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    add_scenario(parser, "+")
    add_run(parser)
    add_out(parser, "results")
