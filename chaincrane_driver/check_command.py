"""chaincrane check, and chaincrane export: runs against references, in our form and another."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

from . import checking, compare, crosscheck, scenario
from .errors import UserError, instead
from .instances import describe
from .processes import simulate_all
from .scenario import Run, Scenario
from .stale import say_if_stale
from .tables import Table, read_table, write_table

FMI_PLATFORM = {"linux": "linux64", "win32": "win64", "darwin": "darwin64"}


def command_check(options: argparse.Namespace) -> int:
    """Compare every run with its frozen reference; 1 where an output changed.

    A line for each run names its worst signal. --junit and --json write what CI servers read;
    --results checks CSV files that chaincrane run, or any other tool, has written. Comparisons
    between hosts hold for runs of some ten seconds: without damping the nonlinear crane is chaotic,
    and two hosts that are both right part by 1e-6 m after 42 s (heavy payload) or 22 s (light).
    """
    if options.update:
        return _update(options, _runs_to_check(options))
    try:
        verdicts = _crosschecked(options) if options.crosscheck else _checked(options)
    except UserError as error:  # nothing could be compared: CI is to see why, too
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


def _simulated(options: argparse.Namespace, runs: list[tuple[Scenario, Run]]) -> list[Table]:
    jobs = [one.job(run, options.fmu or options.fmus / run.fmu) for one, run in runs]
    if say_if_stale(job.fmu for job in jobs) and not options.accept_stale:
        raise UserError("nothing was checked: an FMU is stale (--accept-stale checks it as it is)")
    return simulate_all(jobs, "check")


def _update(options: argparse.Namespace, runs: list[tuple[Scenario, Run]]) -> int:
    if options.results is not None:
        raise UserError("--update makes references of FMUs, not of --results")
    for (one, run), result in zip(runs, _simulated(options, runs), strict=True):
        write_table(one.reference(run), compare.reference_rows(one, result), digits=12)
        print(f"written: {one.reference(run)}")
    return 0


def _checked(options: argparse.Namespace) -> list[checking.Verdict]:
    runs = _runs_to_check(options)
    if options.results is None:
        results: list[Table | None] = [*_simulated(options, runs)]
        names = [str(options.fmu or options.fmus / run.fmu) for _, run in runs]
    else:
        paths = [options.results / one.name / f"{run.name}.csv" for one, run in runs]
        results = [read_table(path) if path.exists() else None for path in paths]
        names = [str(path) for path in paths]
    verdicts = []
    for (one, run), result, name in zip(runs, results, names, strict=True):
        verdict = checking.Verdict(one.name, run.label, name)
        if result is None:
            verdict = replace(verdict, trouble=f"{name}: no such file")
        elif not one.reference(run).exists():
            verdict = replace(verdict, trouble="has no reference; make one with --update")
        else:
            found = compare.deviations(one, run, result, read_table(one.reference(run)))
            verdict = replace(verdict, deviations=found, units=_units(options, run))
        verdicts.append(verdict)
    return verdicts


def _units(options: argparse.Namespace, run: Run) -> dict[str, str | None]:
    """Units of an FMU's variables; none where only its results are here."""
    fmu = options.fmu or options.fmus / run.fmu
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
    results = simulate_all([crosscheck.job_of(folder) for folder in folders], "check")
    return [
        checking.Verdict("cross-check", one.name, str(one), crosscheck.deviations(one, result))
        for one, result in zip(folders, results, strict=True)
    ]


def command_export(options: argparse.Namespace) -> int:
    """Write runs in the form of the FMI cross-check rules: FMU, inputs, reference, options.

    That form has no start values, so only runs that start with the FMU's own are written.
    """
    runs = [(one, run) for one in map(scenario.load, options.scenario) for run in one.runs]
    written = []
    for one, run in runs:
        fmu = options.fmus / run.fmu
        if options.run is None and crosscheck.default_starts(one, run, fmu):
            print(f"left out: {one.name}, {run.name}: it has start values of its own")
        elif options.run in (None, run.name):
            written += crosscheck.export(one, run, fmu, options.out)
    for folder in written:
        print(f"written: {folder}")
    return 0 if written else 1


def add_check_options(check: argparse.ArgumentParser) -> None:
    """The options of chaincrane check."""
    check.add_argument("scenario", type=Path, nargs="*", help="scenario folders (all)")
    check.add_argument("--fmu", type=Path, help="check this FMU, which has the same interface")
    check.add_argument(
        "--model",
        metavar="NAME",
        help="check runs of this model only: crane_nl; what --fmu stands for",
    )
    check.add_argument(
        "--results", type=Path, metavar="DIR", help="check DIR/SCENARIO/RUN.csv, and run nothing"
    )
    check.add_argument(
        "--crosscheck", type=Path, metavar="DIR", help="check folders that export has written"
    )
    check.add_argument("--junit", type=Path, metavar="FILE", help="write JUnit's XML, for CI")
    check.add_argument("--json", type=Path, metavar="FILE", help="write every signal, as JSON")
    check.add_argument(
        "--accept-stale",
        action="store_true",
        help="check FMUs too that are not what the sources beside this program would make",
    )
    check.add_argument("--update", action="store_true", help="rewrite the references, on purpose")


def add_export_options(exporting: argparse.ArgumentParser) -> None:
    """The options of chaincrane export."""
    exporting.add_argument(
        "scenario", type=Path, nargs="+", help="a scenario's folder, or the name of one of ours"
    )
    exporting.add_argument("--run", metavar="NAME", help="one run of the scenario (all)")
    exporting.add_argument("--out", type=Path, default=Path("crosscheck"), help="(crosscheck)")
