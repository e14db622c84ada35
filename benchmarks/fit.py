#!/usr/bin/env python3
"""Does chaincrane fit find what the data were made with, and are its standard errors true?

The heavy payload's stop in the nonlinear FMU, seen by a camera at 50 Hz that is late, biased and
noisy, in steps of 1 mm, with a tenth of its samples lost; starts are wrong by a factor of two.

    python benchmarks/fit.py crane_nl_native.fmu --sets 100
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from time import perf_counter

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "fmu_src"), str(ROOT / "tests")]

from test_07_fit import BIAS, SHIFT, TRUE, heavy, measured

from chaincrane_driver import fit
from chaincrane_driver.compare import markdown_table


def main() -> int:
    """Print how often each true value is within two standard errors."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("fmu", type=Path)
    parser.add_argument("--sets", type=int, default=100, help="noisy data sets (100)")
    parser.add_argument("--first", type=int, default=0, help="the first one's seed (0)")
    options = parser.parse_args()
    job = heavy(options.fmu)
    true = np.array([*TRUE.values(), SHIFT, BIAS])
    ratios, times, runs = [], [], []
    for seed in range(options.first, options.first + options.sets):
        data = measured(options.fmu, seed)
        wrong = 2.0 ** np.random.default_rng([seed, 1]).choice([-1, 1], len(TRUE))
        guesses = dict(zip(TRUE, wrong * list(TRUE.values()), strict=True))
        starts = [f"{name}={value}" for name, value in guesses.items()]
        asked = fit.parameters(job, data, starts, shift=True, bias=True)
        begun = perf_counter()
        found = fit.fit(job, data, asked)
        times.append(perf_counter() - begun)
        runs.append(found.runs)
        ratios.append((found.values - true) / found.errors)
        print(seed, np.round(ratios[-1], 2), f"{times[-1]:.1f} s, {runs[-1]} runs", flush=True)
    inside = np.abs(ratios) < 2.0
    spread = np.sqrt(np.mean(np.square(ratios), axis=0))
    rows = [
        (one.name, f"{inside[:, place].sum()} of {len(inside)}", f"{spread[place]:.2f}")
        for place, one in enumerate(asked)
    ]
    print(markdown_table(("parameter", "within two standard errors", "their RMS ratio"), rows))
    print(f"{np.median(times):.1f} s, {np.median(runs):.0f} runs a fit; longest {max(times):.1f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
