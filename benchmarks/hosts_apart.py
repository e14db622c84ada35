"""For how long do two hosts agree? The nonlinear crane, twice, but for round-off.

The paper's run: 0.8 m/s, a stop after a second, then free swing for two minutes.
Ten elements, 1 ms.
Prints until when the payload's places are within 1e-9, 1e-6, 1e-4 and 1e-2 m, for

- step sizes of 5 ms from a host that hands them on, and from one that takes t[i+1] - t[i];
- the same for 1/60 s, which is no whole number of solver.max_step;
- a gravity that is off by 1e-15 of it, as another compiler's round-off may be;
- that with damping.air = 0.05 1/s.

Needs a C compiler: pip install -e ".[build]".
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from chaincrane.clock import meant_step
from chaincrane.plant.command import Command
from chaincrane.plant.kernel import NativeCrane, load_library
from chaincrane.plant.parameters import (
    MAOURANE_SZABO_2020_HEAVY,
    MAOURANE_SZABO_2020_LIGHT,
    Crane,
    Damping,
    Numerics,
)
from chaincrane_builder.compile_c import kernel_for_host

END, SPEED, STOP_AT = 120.0, 0.8, 1.0  # s, m/s, s
LIMITS = (1e-9, 1e-6, 1e-4, 1e-2)  # m
PLACE = 4  # of payload.x among the outputs
MAX_STEP = Numerics().max_step


def places(crane: Crane, times: np.ndarray, sizes: np.ndarray, library: Any) -> np.ndarray:
    """payload.x, m, after each step, of sizes as a slave hands them to the model."""
    model = NativeCrane(crane, library=library)
    seen = []
    for time, size in zip(times.tolist(), sizes.tolist(), strict=True):
        speed = SPEED if time < STOP_AT - 1e-9 else 0.0
        model.step(meant_step(time, size, MAX_STEP), Command(trolley_v_cmd=speed))
        seen.append(model.output_values()[PLACE])
    return np.array(seen)


def until(one: np.ndarray, other: np.ndarray, h: float) -> str:
    """The times, s, when the two are first apart by more than each limit."""
    gap = np.abs(one - other)
    apart = [np.flatnonzero(gap > limit) for limit in LIMITS]
    words = [f"{h * (steps[0] + 1):.0f} s" if len(steps) else "-" for steps in apart]
    return "   ".join(f"{word:>6}" for word in words) + f"   largest {gap.max():.1e} m"


def main() -> None:
    """Print the table."""
    with TemporaryDirectory() as folder:
        library = load_library(str(kernel_for_host(Path(folder))))
    print("until payload.x is apart by 1e-9, 1e-6, 1e-4, 1e-2 m (-: not in two minutes)")
    for name, crane in (
        ("heavy", MAOURANE_SZABO_2020_HEAVY),
        ("light", MAOURANE_SZABO_2020_LIGHT),
    ):
        for label, h in (("5 ms", 0.005), ("1/60 s", 1.0 / 60.0)):
            times = h * np.arange(round(END / h) + 1)
            plain = np.full(len(times) - 1, h)
            one = places(crane, times[:-1], plain, library)
            other = places(crane, times[:-1], np.diff(times), library)
            print(f"{name}, {label:22} {until(one, other, h)}")
        h = 0.005
        times = h * np.arange(round(END / h))
        for label, air in (("gravity", 0.0), ("gravity, damping.air", 0.05)):
            damped = replace(crane, damping=Damping(air=air))
            other_g = replace(damped, gravity=damped.gravity * (1.0 + 1e-15))
            plain = np.full(len(times), h)
            one = places(damped, times, plain, library)
            other = places(other_g, times, plain, library)
            print(f"{name}, {label:22} {until(one, other, h)}")


if __name__ == "__main__":
    main()
