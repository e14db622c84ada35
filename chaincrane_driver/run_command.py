"""chaincrane run: a scenario's runs, and what the other commands need of them."""

from __future__ import annotations

import argparse
from pathlib import Path

from . import compare, plots, scenario, shipped
from .errors import UserError, instead
from .instances import describe
from .options import add_out, add_scenario
from .processes import simulate_all
from .scenario import Scenario
from .simulate import Job
from .stale import say_if_stale
from .tables import Table, write_table


def command(options: argparse.Namespace) -> int:
    """Run scenarios: results as CSV, a table of differences, a picture."""
    for folder in options.scenario:
        one = scenario.load(folder)
        results = run_all(one, options.fmus)
        units = checked_units(one, options.fmus)
        out = options.out / one.name
        for name, table in results.items():
            write_table(out / f"{name}.csv", table)
        print(f"{one.title} ({one.name})\n\n{compare.comparison_table(one, results, units)}\n")
        pictures = plots.comparison(one, results, units, out / "comparison")
        print(f"written: {out}/*.csv, {', '.join(str(path) for path in pictures)}\n")
    return 0


def run_all(one: Scenario, fmus: Path) -> dict[str, Table]:
    """Simulate every run of a scenario."""
    tables = simulate_all(jobs_of(one, fmus), one.name)
    return {run.name: table for run, table in zip(one.runs, tables, strict=True)}


def jobs_of(one: Scenario, fmus: Path) -> list[Job]:
    """Every run of a scenario as work; says it where an FMU is stale."""
    jobs = [one.job(run, shipped.fmu(fmus, run.fmu)) for run in one.runs]
    say_if_stale(job.fmu for job in jobs)
    return jobs


def checked_units(one: Scenario, fmus: Path) -> dict[str, str | None]:
    """Units of the first run's variables by name; raises UserError for a signal it has not."""
    variables = describe(shipped.fmu(fmus, one.runs[0].fmu)).modelVariables
    outputs = [variable for variable in variables if variable.causality == "output"]
    units = {variable.name: variable.unit for variable in outputs}
    for name in one.look_at:
        if name not in units:
            path, near = one.folder / "scenario.toml", instead(name, units)
            raise UserError(f"{path}: look_at: there is no {name!r}{near}")
    return units


def add_options(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    add_scenario(parser, "+")
    add_out(parser, "results")
