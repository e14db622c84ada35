"""chaincrane sweep: its options, and what it prints."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from . import dataset, scenario, shipped, vary
from .antisway import Setup, parse_setting
from .cluster import dask
from .compare import markdown_table, shown
from .dataset import Results
from .errors import UserError, instead
from .options import add_run
from .stale import say_if_stale
from .subjects import Metric, Subject, loop_subject, scenario_subject
from .sweep import Scheduler, local, sweep
from .sweep_plots import sweep_figure
from .vary import Design

LOOP = "antisway"  # stands for the closed loop where a scenario's folder would


def command(options: argparse.Namespace) -> int:
    """Run a scenario, or the closed loop, for many values of what varies: dataset, CSV, picture.

    WHAT is FIRST:LAST:COUNT, with :log behind it if spaced by logarithms; values A,B,C; or
    uniform(A,B), loguniform(A,B), normal(MEAN,STD), drawn --samples times. Ranges and values make
    a grid. Of the closed loop, NAME is a word like payload, elements or sensor, or a start value
    PART::NAME. What is done is kept: the same command goes on after Ctrl-C. 1 where no run was
    done.
    """
    design = vary.design(options.vary, options.samples, options.method, options.seed, options.cases)
    subject = _subject(options, design)
    if subject.kept:
        dataset.require_all()
    metrics = _drawn(subject, options.draw)
    say_if_stale(subject.fmus.values())
    out = options.out or Path("results") / f"sweep_{Path(options.subject).resolve().name}"
    files = sweep(subject, design, out, _scheduler(options), options.anew)
    results = dataset.read_csv(files.table, subject, design)
    title = f"{len(design)} cases of {Path(options.subject).name}"
    pictures = sweep_figure(subject, design, results, metrics, title, out / "sweep")
    print(f"{summary(subject, results, metrics)}\n")
    written = [path for path in (files.netcdf, files.table, *pictures) if path.exists()]
    print("written: " + ", ".join(map(str, written)))
    if not files.netcdf.exists():
        print(f"no NetCDF: that needs {dataset.INSTALL}")
    return 1 if results.failed == results.messages.size else 0


def summary(subject: Subject, results: Results, metrics: list[Metric]) -> str:
    """How many runs failed, why first, and the ranges of the metrics drawn."""
    places = {metric.name: place for place, metric in enumerate(subject.metrics)}
    rows = []
    for metric in metrics:
        factor, unit = shown(metric.unit)
        for run, label in enumerate(subject.runs):
            values = results.values[:, run, places[metric.name]]
            values = factor * values[np.isfinite(values)]
            if len(values):
                cells = (values.min(), np.median(values), values.max())
                rows.append((metric.name, label, *(f"{one:.4g} {unit}".strip() for one in cells)))
    text = markdown_table(("metric", "run", "least", "median", "largest"), rows)
    runs, failures = results.messages.size, results.failed
    text += f"\n\n{runs - failures} of {runs} runs done"
    if failures:
        first = next(message for message in results.messages.flat if message)
        text += f", {failures} failed, the first: {first}"
    return text


def _subject(options: argparse.Namespace, design: Design) -> Subject:
    if options.subject != LOOP:
        if options.set:
            raise UserError(f"--set is for the closed loop: chaincrane sweep {LOOP}")
        one = scenario.load(shipped.scenario(Path(options.subject)))
        runs = one.named(options.run)
        if options.fmu is not None and len(runs) > 1:
            raise UserError("--fmu stands in for one run's FMU: choose it by --run NAME")
        return scenario_subject(one, runs, options.fmus, options.signals, options.keep, options.fmu)
    if options.run or options.fmu or options.signals:
        raise UserError(f"--run, --fmu and --signals are for scenarios, not for {LOOP}")
    more: dict[str, dict[str, object]] = {}
    for text in options.set:
        part, name, value = parse_setting(text)
        more.setdefault(part, {})[name] = value
    return loop_subject(Setup(more=more), options.fmus, design, options.keep)


def _drawn(subject: Subject, names: tuple[str, ...]) -> list[Metric]:
    metrics = {metric.name: metric for metric in subject.metrics}
    for name in names:
        if name not in metrics:
            raise UserError(f"--draw: there is no metric {name!r}{instead(name, metrics)}")
    return [metrics[name] for name in names or subject.drawn]


def _scheduler(options: argparse.Namespace) -> Scheduler:
    if options.processes is not None and options.processes < 1:
        raise UserError(f"--processes {options.processes} is not allowed: 1 or more")
    if options.scheduler is not None:
        if options.processes is not None:
            raise UserError("--processes is for this machine: the cluster has its own")
        return dask(options.scheduler)
    return local(options.processes)


def add_options(parser: argparse.ArgumentParser) -> None:
    """The command's options."""

    def names(text: str) -> tuple[str, ...]:
        return tuple(filter(None, text.split(",")))

    parser.add_argument(
        "subject", help=f"a scenario's folder, the name of one of ours, or {LOOP}: the closed loop"
    )
    parser.add_argument(
        "--vary", action="append", default=[], metavar="NAME=WHAT", help="what varies; any number"
    )
    parser.add_argument("--cases", type=Path, metavar="FILE", help="CSV file with a case a row")
    parser.add_argument("--samples", type=int, metavar="N", help="draws of random variables")
    parser.add_argument(
        "--method",
        choices=vary.METHODS,
        default=vary.METHODS[0],
        help="independent draws, a Latin hypercube, or Sobol's sequence (random)",
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the draws (0)")
    add_run(parser)
    parser.add_argument("--fmu", type=Path, metavar="FILE", help="this FMU instead of the run's")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="PART::NAME=VALUE",
        help="a start value of the closed loop",
    )
    parser.add_argument(
        "--signals",
        type=names,
        default=(),
        metavar="NAME,NAME",
        help="measure these too, beside what the scenario looks at",
    )
    parser.add_argument(
        "--keep", type=names, default=(), metavar="NAME,NAME", help="keep these time series"
    )
    parser.add_argument(
        "--draw", type=names, default=(), metavar="METRIC,METRIC", help="what the picture shows"
    )
    parser.add_argument("--processes", type=int, metavar="N", help="workers (one a core)")
    parser.add_argument(
        "--scheduler", metavar="ADDRESS", help="of a Dask cluster to run on, tcp://HOST:8786 say"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder (results/sweep_NAME)")
    parser.add_argument("--anew", action="store_true", help="discard what is in the folder")
