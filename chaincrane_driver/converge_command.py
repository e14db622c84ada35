"""chaincrane converge."""

from __future__ import annotations

import argparse

from . import converge, plots, scenario, shipped
from .options import add_out, add_run, add_scenario
from .stale import say_if_stale


def command(options: argparse.Namespace) -> int:
    """Estimate the time and mesh errors of a scenario's runs: tables, CSV, a picture.

    Each run is repeated with solver.max_step halved twice, then with chain.elements doubled twice.
    Where the differences do not shrink, or are large, the signal is not predictable: so it says.
    """
    one = scenario.load(options.scenario)
    runs = one.named(options.run)
    say_if_stale(shipped.fmu(options.fmus, run.fmu) for run in runs)
    findings = converge.study(one, runs, options.fmus, options.signals)
    path = options.out / one.name / "convergence.csv"
    converge.write_csv(path, findings)
    drawn = options.signals or one.look_at
    signals = [signal for signal in findings[0].signals if signal.name in drawn]
    pictures = plots.convergence_figure(
        findings[0], signals, f"{one.title}: how well it converges", path.with_suffix("")
    )
    print(f"{one.title} ({one.name})\n")
    for finding in findings:
        print(f"{finding.settings}\n\n{converge.table(finding)}\n")
    print(f"{converge.LEGEND}\n")
    print("written: " + ", ".join(str(one) for one in (path, *pictures)))
    return 0


def add_options(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    add_scenario(parser)
    add_run(parser)
    parser.add_argument(
        "--signals",
        type=lambda text: tuple(filter(None, text.split(","))),
        default=(),
        metavar="NAME,NAME",
        help="Real outputs to judge and to draw (what the scenario looks at is drawn; judged too:"
        f" {', '.join(converge.BESIDES)})",
    )
    add_out(parser, "results")
