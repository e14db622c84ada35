"""chaincrane check: runs against references, in our form and another."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TypeVar

from . import checking, compare, crosscheck, scenario, shipped
from .errors import UserError, instead
from .instances import describe
from .options import add_scenario, add_scenarios
from .processes import Failure, simulate_all, simulate_each
from .scenario import Run, Scenario
from .simulate import Job
from .stale import say_if_stale
from .tables import read_table, write_table

Given = TypeVar("Given")

FMI_PLATFORM = {"linux": "linux64", "win32": "win64", "darwin": "darwin64"}


def command(options: argparse.Namespace) -> int:
    """Compare every run with its frozen reference; 1 where one differs or cannot be compared.

    A line for each run names its worst signal. --junit and --json write what CI servers read;
    --results checks CSV files that chaincrane run, or any other tool, has written. Comparisons
    between hosts hold for runs of some ten seconds: without damping the nonlinear crane is chaotic,
    and two hosts that are both right part by 1e-6 m after 42 s (heavy payload) or 22 s (light).
    """
    if options.update:
        return _update(options, _runs_to_check(options))
    try:
        verdicts = _crosschecked(options) if options.crosscheck else _checked(options)
    except UserError as error:  # no run is known yet: CI is to see why, too
        if options.junit is not None:
            nothing = checking.Verdict("check", "all runs", "chaincrane", trouble=str(error))
            checking.write_junit(options.junit, [nothing])
        raise
    for verdict in verdicts:
        print(verdict.line())
    if options.json is not None:
        checking.write_json(options.json, verdicts)
    if options.junit is not None:
        checking.write_junit(options.junit, verdicts)
    failed = sum(not verdict.passed for verdict in verdicts)
    print(f"{len(verdicts) - failed} runs as their references, {failed} not")
    return 1 if failed else 0


def _runs_to_check(options: argparse.Namespace) -> list[tuple[Scenario, Run]]:
    scenarios = [scenario.load(folder) for folder in options.scenario] or scenario.find(
        options.scenarios
    )
    every = [(one, run) for one in scenarios for run in one.runs]
    named = options.model
    if named is None and options.fmu is not None:
        named = str(describe(options.fmu).modelName)  # crane_nl_native, say
    if named is None:
        return every
    models = dict.fromkeys(Path(run.fmu).stem for _, run in every)
    if options.model is not None and named not in models:
        raise UserError(f"--model: no scenario runs {named!r}{instead(named, models)}")
    runs = [(one, run) for one, run in every if named.startswith(Path(run.fmu).stem)]
    if not runs:
        known = " or ".join(f"--model {model}" for model in models)
        raise UserError(f"{options.fmu}: its model is {named!r}; say what it stands for: {known}")
    return runs


def _jobs(options: argparse.Namespace, runs: list[tuple[Scenario, Run]]) -> list[Job]:
    jobs = [one.job(run, options.fmu or shipped.fmu(options.fmus, run.fmu)) for one, run in runs]
    if say_if_stale(job.fmu for job in jobs) and not options.accept_stale:
        raise UserError("nothing was checked: an FMU is stale (--accept-stale checks it as it is)")
    return jobs


def _update(options: argparse.Namespace, runs: list[tuple[Scenario, Run]]) -> int:
    if options.results is not None:
        raise UserError("--update makes references of FMUs, not of --results")
    results = simulate_all(_jobs(options, runs), "check")
    for (one, run), result in zip(runs, results, strict=True):
        write_table(one.reference(run), compare.reference_rows(one, result), digits=12)
        print(f"written: {one.reference(run)}")
    return 0


def _checked(options: argparse.Namespace) -> list[checking.Verdict]:
    runs = _runs_to_check(options)
    if options.results is None:
        jobs = _jobs(options, runs)
        names = [job.name for job in jobs]
        work = [compare.Comparison(*run, job) for run, job in zip(runs, jobs, strict=True)]
        found = simulate_each(work, "check")
    else:
        paths = [options.results / one.name / f"{run.name}.csv" for one, run in runs]
        names = [str(path) for path in paths]
        found = [_compared(*run, path) for run, path in zip(runs, paths, strict=True)]
    units = cache(_units)  # an FMU has many runs
    verdicts = []
    for (one, run), name, result in zip(runs, names, found, strict=True):
        verdict = checking.Verdict(one.name, run.label, name)
        try:
            fmu = options.fmu or shipped.fmu(options.fmus, run.fmu)
            verdict = replace(verdict, deviations=_there(result), units=units(fmu))
        except UserError as error:
            verdict = replace(verdict, trouble=str(error))
        verdicts.append(verdict)
    return verdicts


def _compared(one: Scenario, run: Run, path: Path) -> list[compare.Deviation] | Failure:
    """A result in a CSV file against its run's reference."""
    try:
        return compare.against_reference(one, run, read_table(path))
    except UserError as error:
        return Failure(error)


def _there(result: Given | Failure) -> Given:
    """What a run gave. Raises UserError where it failed."""
    if isinstance(result, Failure):
        raise UserError(result)
    return result


def _units(fmu: Path) -> dict[str, str | None]:
    """Units of an FMU's variables; none where only its results are here."""
    if not fmu.exists():
        return {}
    return {variable.name: variable.unit for variable in describe(fmu).modelVariables}


def _crosschecked(options: argparse.Namespace) -> list[checking.Verdict]:
    """Verdicts on folders in the form of the FMI cross-check."""
    top = options.crosscheck
    here = FMI_PLATFORM.get(sys.platform, "linux64")
    folders = sorted(file.parent for file in top.rglob("*_ref.opt"))
    folders = [one for one in folders if one == top or here in one.parts or len(folders) == 1]
    if not folders:
        raise UserError(f"{top}: no *_ref.opt for {here} here")
    results = simulate_each([crosscheck.job_of(folder) for folder in folders], "check")
    verdicts = []
    for folder, result in zip(folders, results, strict=True):
        verdict = checking.Verdict("cross-check", folder.name, str(folder))
        try:
            verdict = replace(verdict, deviations=crosscheck.deviations(folder, _there(result)))
        except UserError as error:
            verdict = replace(verdict, trouble=str(error))
        verdicts.append(verdict)
    return verdicts


def add_options(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    add_scenarios(parser)
    add_scenario(parser, "*")
    parser.add_argument(
        "--fmu", type=Path, metavar="FILE", help="check this FMU, which has the same interface"
    )
    parser.add_argument(
        "--model",
        metavar="NAME",
        help="check runs of this model only: crane_nl; what --fmu stands for",
    )
    parser.add_argument(
        "--results", type=Path, metavar="DIR", help="check DIR/SCENARIO/RUN.csv, and run nothing"
    )
    parser.add_argument(
        "--crosscheck", type=Path, metavar="DIR", help="check folders that export has written"
    )
    parser.add_argument("--junit", type=Path, metavar="FILE", help="write JUnit's XML, for CI")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every signal, as JSON")
    parser.add_argument(
        "--accept-stale",
        action="store_true",
        help="check FMUs too that are not what the sources beside this program would make",
    )
    parser.add_argument("--update", action="store_true", help="rewrite the references, on purpose")
