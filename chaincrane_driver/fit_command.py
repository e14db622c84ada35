"""chaincrane fit: its options, and what it prints."""

from __future__ import annotations

import argparse
from pathlib import Path

from . import fit, scenario, shipped
from .instances import describe
from .options import add_scenario
from .stale import say_if_stale


def command(options: argparse.Namespace) -> int:
    """Fit parameters of the crane to measured signals: values, standard errors, a picture.

    The scenario says what moved and for how long; the CSV file has a column for each measured
    output, empty where a sample is missing. The start of --fit NAME=START may be off by a factor
    of two; without START it is the scenario's.
    """
    one = scenario.load(options.scenario)
    run, *_ = one.named([options.run] if options.run else [])
    job = one.job(run, options.fmu or shipped.fmu(options.fmus, run.fmu))
    say_if_stale([job.fmu])
    measured = fit.read_measured(options.measured)
    asked = fit.parameters(job, measured, options.fit, options.shift, options.bias)
    found = fit.fit(job, measured, asked)
    print(fit.report(found) + "\n")
    units = {v.name: v.unit for v in describe(job.fmu).modelVariables}
    out = options.out or Path("results") / f"fit_{options.measured.stem}"
    fit.write_csv(out / "fit.csv", found)
    pictures = fit.picture(found, units, f"{options.measured.name}: {run.label}", out / "fit")
    print("written: " + ", ".join(map(str, (out / "fit.csv", *pictures))))
    return 0


def add_options(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    add_scenario(parser)
    parser.add_argument("measured", type=Path, help="CSV file: time, then outputs by their names")
    parser.add_argument(
        "--fit", action="append", default=[], metavar="NAME[=START]", help="a parameter to fit"
    )
    parser.add_argument("--shift", action="store_true", help=f"fit {fit.SHIFT}: the sensor is late")
    parser.add_argument("--bias", action="store_true", help="fit a bias of each signal")
    parser.add_argument("--run", metavar="NAME", help="the run whose crane is fitted (the first)")
    parser.add_argument("--fmu", type=Path, metavar="FILE", help="this FMU instead of the run's")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder (results/fit_NAME)")
