#!/usr/bin/env python3
"""How fast is a sweep, beside the bare kernel in the same minute?

The paper's 4 s, the payload's mass varied, five signals kept every 5 ms, through workers as
chaincrane sweep uses them. The kernel's rate is that of its steps alone, called from Python, by as
many processes at once as there are workers. It is measured between the parts of the sweep, as the
machine's own speed changes from minute to minute.

    python benchmarks/ensembles.py               table on stdout; needs a compiler
    python benchmarks/ensembles.py --runs 10000
"""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter, process_time

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "fmu_src")]

from chaincrane.plant.kernel import NativeCrane, load_library
from chaincrane_builder.compile_c import kernel_for_host
from chaincrane_builder.pack import build
from chaincrane_driver import scenario, vary
from chaincrane_driver.compare import markdown_table
from chaincrane_driver.journal import Journal
from chaincrane_driver.processes import Workers
from chaincrane_driver.subjects import scenario_subject
from chaincrane_driver.sweep import outcomes

KEPT = ("payload.x", "payload.x_rel", "chain.mid_x_rel", "chain.tension_top", "trolley.fx")
STEPS, STEP, STOP_AT, SPEED = 800, 0.005, 200, 0.8  # the paper's run: 4 s, stopped after 1 s
PARTS = 10  # of a sweep
BARE_RUNS = 40  # between two of them


def bare(library: str) -> float:
    """Processor time of a run of the kernel's steps alone, s, the mean of many."""
    loaded = load_library(library)
    times = []
    for _ in range(BARE_RUNS):
        crane = NativeCrane(library=loaded)
        step, exchange, command = crane._c_step, crane._exchange_address, crane._command
        begun = process_time()
        command.trolley_v_cmd = SPEED
        for _ in range(STOP_AT):
            step(exchange, STEP)
        command.trolley_v_cmd = 0.0
        for _ in range(STEPS - STOP_AT):
            step(exchange, STEP)
        times.append(process_time() - begun)
    return sum(times) / len(times)


@dataclass(frozen=True)
class Rate:
    """What a sweep takes: s of wall time, s of the workers' processor time, s to the first run."""

    wall: float
    workers: float
    first: float
    kernel: float  # s of processor time, of a run of the kernel's steps alone


def swept(fmu: Path, runs: int, processes: int, folder: Path, library: str) -> Rate:
    """Run a sweep into a journal, in parts, and the bare kernel between them."""
    one = scenario.load(ROOT / "scenarios" / "paper_heavy")
    subject = scenario_subject(one, one.runs[:1], fmu.parent, kept=KEPT, fmu=fmu)
    cases = list(vary.design([f"payload.mass=0.05:0.5:{runs}"]).cases())
    book = Journal(folder, {})
    wall, first = 0.0, 0.0
    alone: list[float] = []
    with ProcessPoolExecutor(processes) as pool:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        with Workers(processes) as workers:
            for part in range(PARTS):
                alone += pool.map(bare, [library] * processes)
                begun, fresh = perf_counter(), []
                for outcome in outcomes(workers, subject, cases[part::PARTS]):
                    first = first or perf_counter() - begun
                    fresh.append(outcome)
                book.add(fresh)
                wall += perf_counter() - begun
        after = resource.getrusage(resource.RUSAGE_CHILDREN)  # the pool's have not ended yet
    book.discard()
    used = sum(after[:2]) - sum(before[:2])
    return Rate(wall, used, first, sum(alone) / len(alone))


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=1000, help="runs of each sweep (1000)")
    options = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        library = str(kernel_for_host(folder / "kernel"))
        for model in ("crane_nl_native", "crane_nl"):
            fmu = build(model, folder)
            for processes in (1, 2):
                rate = swept(fmu, options.runs, processes, folder / "out", library)
                each = rate.workers / options.runs
                rows.append(
                    [
                        model,
                        str(processes),
                        f"{options.runs / rate.wall:.0f}",
                        f"{1e3 * rate.kernel:.2f} ms",
                        f"{1e3 * each:.2f} ms",
                        f"{rate.kernel / each:.2f}",
                        f"{rate.kernel * options.runs / processes / rate.wall:.2f}",
                        f"{rate.first:.2f} s",
                    ]
                )
    head = ["FMU", "processes", "runs/s", "bare kernel", "worker", "kernel / worker"]
    head += ["rate per core / kernel's", "first result"]
    print(markdown_table(head, rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
