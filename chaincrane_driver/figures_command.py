"""chaincrane figures."""

from __future__ import annotations

import argparse

from . import compare, plots, scenario
from .options import add_out, add_scenarios
from .places import whole_file
from .processes import do_all, workers_for
from .run_command import checked_units, jobs_of

PAPER = (("heavy payload", "paper_heavy"), ("light payload", "paper_light"))


def command(options: argparse.Namespace) -> int:
    """Draw the paper's Figs. 4 to 7 from the FMUs, with the comparison in numbers."""
    scenarios = [scenario.load(options.scenarios / name) for _, name in PAPER]
    jobs = [job for one in scenarios for job in jobs_of(one, options.fmus)]
    units = [checked_units(one, options.fmus) for one in scenarios]
    with workers_for(len(jobs)) as workers:
        tables = iter(do_all(workers, jobs, "runs"))
        results = [{run.name: next(tables) for run in one.runs} for one in scenarios]
        for one, found, of in zip(scenarios, results, units, strict=True):
            print(f"{one.title}\n\n{compare.comparison_table(one, found, of)}\n")
        labels = (label for label, _ in PAPER)
        panels = list(zip(labels, scenarios, results, strict=True))
        drawings = plots.papers_figures(panels, options.out)
        files = [file for files in do_all(workers, drawings, "figures") for file in files]
    for path, content in files:
        with whole_file(path) as partial:
            partial.write_bytes(content)
    print("written: " + ", ".join(str(path) for path, _ in files))
    return 0


def add_options(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    add_scenarios(parser)
    add_out(parser, "figures")
