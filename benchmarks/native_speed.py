#!/usr/bin/env python3
"""Is a native FMU fit for a hard real-time box? Its worst 1 ms doStep, and its cost beside the
bare model's.

Every scenario, run for 60 s in communication steps of 1 ms by a host in C: 3 inputs set, doStep,
7 outputs read. "worst" is the longest step, each by its least time over the rounds, so that other
programs on this machine do not count; "worst seen" has them in. The bare model is the same C,
compiled the same way, called for its steps alone.

    python benchmarks/native_speed.py               table on stdout; needs Linux and a C compiler
    python benchmarks/native_speed.py --rounds 20
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "fmu_src")]


from chaincrane.plant.interface import INPUTS, NAMES
from chaincrane_builder.compile_c import included, zig_library
from chaincrane_builder.fmus import FMUS
from chaincrane_builder.pack import build, native_sources
from chaincrane_driver.compare import markdown_table
from chaincrane_driver.scenario import find
from chaincrane_driver.simulate import Job

END, STEP = 60.0, 1e-3  # s


@dataclass(frozen=True)
class Times:
    """What native_speed.c prints: us, numbers, ns a step."""

    median: float
    worst: float
    worst_seen: float
    iterations: float
    steps: float
    fmu: float
    bare: float
    bare_with_outputs: float

    @property
    def ratio(self) -> float:
        """Cost of the FMU beside the bare model's steps."""
        return self.fmu / self.bare


class Bench:
    """The timing host and one native FMU."""

    def __init__(self, model: str, folder: Path) -> None:
        self.folder = folder / model
        fmu = build(model, self.folder)
        with zipfile.ZipFile(fmu) as archive:
            archive.extractall(self.folder)
        _, digest = native_sources(model)
        bare = included("bare", str(FMUS[model].crane))
        bare |= {"names.h": b"#define HIDDEN\n#define SHOWN\n"}  # its CRANE is what is timed
        content = zig_library("linux64", bare, "bare", ["-fvisibility=default"])
        (self.folder / "bare.so").write_bytes(content)
        source = str(Path(__file__).with_suffix(".c"))
        host = str(self.folder / "host")
        command = [os.environ.get("CC", "cc"), "-std=c99", "-O2", "-D_POSIX_C_SOURCE=200809L"]
        command += ["-I", str(self.folder / "sources"), source, "-o", host, "-ldl", "-lm"]
        subprocess.run(command, check=True)
        library = self.folder / "binaries" / "linux64" / f"{model}.so"
        self.command = [host, str(library), f"{{{digest}}}", str(self.folder / "bare.so")]

    def times(self, job: Job, rounds: int) -> Times:
        """Times of a scenario's run, its last commands held to the end."""
        commands = self.folder / "commands.txt"
        np.savetxt(commands, held_inputs(job), fmt="%.17g")
        starts = [f"{NAMES.index(name)}={value!r}" for name, value in job.start_values.items()]
        done = subprocess.run(
            [*self.command, str(commands), str(rounds), *starts],
            check=True,
            capture_output=True,
            text=True,
        )
        return Times(*map(float, done.stdout.split()))


def held_inputs(job: Job) -> np.ndarray:
    """The inputs of each step, as FMPy applies them: those after a jump at a repeated time."""
    times = STEP * np.arange(round(END / STEP))
    table = np.zeros((len(times), len(INPUTS)))
    if job.inputs is not None and job.inputs.dtype.names is not None:
        for column, variable in enumerate(INPUTS):
            if variable.name in job.inputs.dtype.names:
                after = times + 1e-9
                table[:, column] = np.interp(after, job.inputs["time"], job.inputs[variable.name])
    return table


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5, help="runs of each scenario (5)")
    options = parser.parse_args()
    rows, ratios = [], []
    with tempfile.TemporaryDirectory() as scratch:
        for model in ("crane_nl", "crane_lin"):
            bench = Bench(f"{model}_native", Path(scratch))
            for one in find(ROOT / "scenarios"):
                run = next(run for run in one.runs if run.fmu == f"{model}.fmu")
                t = bench.times(one.job(run, Path()), options.rounds)
                ratios.append(t.ratio)
                rows.append(
                    [
                        one.name,
                        run.label,
                        f"{t.median:.1f} us",
                        f"{t.worst:.1f} us",
                        f"{t.worst_seen:.0f} us",
                        f"{t.iterations:.0f}",
                        f"{t.steps:.0f}",
                        f"{t.ratio:.2f}",
                        f"{t.fmu / t.bare_with_outputs:.2f}",
                    ]
                )
    head = ["scenario", "model", "median", "worst", "worst seen", "most iterations"]
    head += ["most internal steps", "FMU / bare steps", "FMU / bare steps and outputs"]
    print(markdown_table(head, rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
