"""What the closed loop is held to, measured on the nonlinear crane with 40 elements, undamped.

    python benchmarks/antisway.py                 all parts, worst of the seeds
    python benchmarks/antisway.py moves --seeds 3

Parts: moves, lengths, estimates, pushes, winds, lags, long, sizes, eigenvalues. They run in this
process (no FMU), the crane in C, side by side in steps of 10 ms, as in the SSP package.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import islice, product
from math import radians, sqrt
from pathlib import Path
from typing import Any

import numpy as np

from chaincrane.control import stability
from chaincrane.control.antisway import AntiSway, AntiSwayInput, AntiSwaySettings
from chaincrane.control.design import SHOWN_MODES
from chaincrane.control.drive import followed
from chaincrane.control.move import Limits
from chaincrane.control.observer import CraneObserver, ObserverInput, ObserverSettings
from chaincrane.control.sensor import Camera, Clock, Rope
from chaincrane.plant.command import Command
from chaincrane.plant.kernel import NativeCrane, load_library
from chaincrane.plant.parameters import Chain, Crane, Initial, Numerics, Payload
from chaincrane_builder.compile_c import kernel_for_host

H = 0.01  # s
PAYLOADS = {"heavy": 0.42, "light": 0.07}  # kg
NOISE = {"camera": 0.002, "rope": radians(0.5)}
BIAS = {"camera": 0.005, "rope": radians(0.5)}
MODES = range(1, SHOWN_MODES + 1)
PUSH = (7.0, 7.5, 0.5)  # s, s, m/s2
# A linear program's bound on settling within 5 mm, s, four modes of 40 elements, cells of 20 ms.
BOUNDS = {
    "heavy": {0.1: 0.86, 0.3: 1.20, 1.0: 2.62, 2.0: 4.54, 5.0: 10.20},
    "light": {0.1: 0.78, 0.3: 1.08, 1.0: 2.52, 2.0: 4.36, 5.0: 10.44},
}


@dataclass(frozen=True)
class Run:
    """One run of the loop."""

    payload: str = "heavy"
    sensor: str = "rope"
    target: float = 1.0  # m
    stop: float = 12.0  # s
    seed: int = 1
    length: float = 1.0  # of the crane's chain, by the believed one's
    mass: float = 1.0  # of the crane's payload, by the believed one's
    pushed: bool = False
    wind: float = 0.0  # N
    bias: bool = False
    lag: float = 0.0  # s, of the drive
    told_lag: bool = True
    observer: dict[str, Any] = field(default_factory=dict)
    scale: float = 1.0  # of the lab crane: lengths so, masses by its square, times by its root
    ratio: float | None = None  # payload by chain; None: the lab crane's payload

    @property
    def payload_mass(self) -> float:
        """That is believed, kg."""
        mass = PAYLOADS[self.payload] if self.ratio is None else self.ratio * Chain().mass
        return mass * self.scale**2

    def believed(self) -> Crane:
        """What observer and controller believe."""
        lab, scale = Chain(), self.scale
        chain = Chain(scale * lab.length, scale**2 * lab.mass, scale**2 * lab.EA)
        return Crane(chain, Payload(self.payload_mass))

    def crane(self) -> Crane:
        """The crane."""
        one = self.believed()
        chain = replace(one.chain, length=self.length * one.chain.length)
        return Crane(chain, Payload(self.mass * self.payload_mass))


@cache
def library() -> Any:
    """The nonlinear crane in C, compiled for this machine."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        return load_library(str(kernel_for_host(Path(folder))))


def shares(guess: dict[str, float]) -> dict[str, float]:
    """The controller's inputs from the observer's modes."""
    return {
        f"mode_{name}_{i}": guess[f"mode.{name}[{i}]"]
        for name in ("x_rel", "vx_rel")
        for i in MODES
    }


def simulate(run: Run) -> np.ndarray:
    """Columns time, trolley.v, payload.x, sway, middle, both estimated, command; a row a step."""
    crane = NativeCrane(
        run.crane(),
        Initial(0.0),
        Numerics(elements=40, max_step=0.002 * sqrt(run.scale)),
        library(),
    )
    bias = BIAS[run.sensor] if run.bias else 0.0
    sensors: dict[str, Any] = {
        "camera": Camera(run.scale * NOISE["camera"], bias),
        "rope": Rope(NOISE["rope"], bias),
    }
    lag = run.lag if run.told_lag else 0.0
    watch = CraneObserver(
        ObserverSettings(
            run.believed(),
            speed=0.0,
            sensor=run.sensor,
            clock=Clock(seed=run.seed),
            lag=lag,
            **sensors,
            **run.observer,
        )
    )
    limits = Limits(0.5 * sqrt(run.scale))
    control = AntiSway(AntiSwaySettings(run.believed(), lag=lag, limits=limits))
    a, follows, rows = 0.0, 0.0, []
    for number in range(round(run.stop / H) + 1):
        time, seen, guess = number * H, crane.outputs(), watch.outputs()
        names = ("payload.x_rel", "chain.mid_x_rel")
        rows.append(
            (
                time,
                seen["trolley.v"],
                seen["payload.x"],
                *(seen[name] for name in names),
                *(guess[name] for name in names),
                a,
            )
        )
        told = AntiSwayInput(
            target_x=run.target,
            trolley_x=seen["trolley.x"],
            trolley_v=seen["trolley.v"],
            **shares(guess),
            wind_fx=guess["wind.fx"],
        )
        force = run.wind
        if run.pushed and PUSH[0] <= time < PUSH[1] - 1e-9:
            force += PUSH[2] * run.payload_mass
        moved, follows = followed(follows, a, H, run.lag)
        crane.step(H, Command(trolley_a_cmd=moved, payload_fx=force))
        watch.step(
            H,
            ObserverInput(
                trolley_a_cmd=a,
                camera_x_rel=seen["payload.x_rel"],
                rope_top_angle=seen["chain.top_angle"],
            ),
        )
        control.step(H, told)
        a = control.outputs()["trolley.a_cmd"]
    return np.array(rows)


def measured(run: Run) -> dict[str, float]:
    """Settling in s, lengths in mm, velocity and acceleration."""
    time, v, x, sway, middle, sway_guess, middle_guess, a = simulate(run).T
    outside = np.flatnonzero(np.abs(x - run.target) > 5e-3 * run.scale)
    last = int(outside[-1]) if len(outside) else -1
    late, moving = time >= time[-1] - 5.0, time <= 3.0
    rms: Callable[[np.ndarray], float] = lambda gap: float(1e3 * np.sqrt(np.mean(gap**2)))  # noqa: E731
    return {
        "settles": float("nan") if last == len(time) - 1 else float(time[last + 1]),
        "residual": 1e3 * float(np.abs(sway[late]).max()),
        "off": 1e3 * float(np.abs(x[late] - run.target).max()),
        "moving": rms((sway_guess - sway)[moving]),
        "whole": rms(sway_guess - sway),
        "last": rms((sway_guess - sway)[late]),
        "middle": rms((middle_guess - middle)[moving]),
        "v": float(np.abs(v).max()),
        "a": float(np.abs(a).max()),
    }


Named = tuple[str, Run]


def each() -> Iterator[tuple[str, str]]:
    """Payloads and sensors."""
    return ((payload, sensor) for payload in PAYLOADS for sensor in NOISE)


def moves() -> Iterator[Named]:
    """Distances and signs."""
    for payload, sensor in each():
        for target in (1.0, 0.1, 0.3, 2.0, 5.0, -1.0):
            stop = 12.0 + max(0.0, 2.0 * (abs(target) - 1.0))
            bound = BOUNDS[payload][abs(target)]
            yield f"{target:g} m, bound {bound:.2f} s", Run(payload, sensor, target, stop)


def lengths() -> Iterator[Named]:
    """A chain that is shorter or longer than believed, a payload lighter or heavier."""
    for payload, sensor in each():
        for length in (0.9, 1.1):
            yield f"length x {length:g}", Run(payload, sensor, length=length)
        for mass in (0.7, 1.3):
            yield f"mass x {mass:g}", Run(payload, sensor, mass=mass)


def estimates() -> Iterator[Named]:
    """With a bias that is looked for, and without one."""
    for payload, sensor in each():
        for bias in (False, True):
            one = Run(payload, sensor, stop=60.0, bias=bias, observer={"offset": "bias"})
            yield f"bias {'there' if bias else 'not there'}", one


def pushes() -> Iterator[Named]:
    """A push after the move; it settles so long after 7.5 s."""
    for payload, sensor in each():
        yield "push, ends at 7.5 s", Run(payload, sensor, stop=20.0, pushed=True)


def winds() -> Iterator[Named]:
    """A wind from the start."""
    for payload, sensor in each():
        yield "wind of 0.3 N", Run(payload, sensor, stop=60.0, wind=0.3)


def lags() -> Iterator[Named]:
    """A drive of 50 ms, told and not told."""
    for payload, sensor in each():
        for told in (True, False):
            yield f"lag of 50 ms, told: {told}", Run(payload, sensor, lag=0.05, told_lag=told)


def long() -> Iterator[Named]:
    """Five minutes; residual: the last 5 s."""
    for payload, sensor in each():
        for length, mass in ((1.0, 1.0), (1.0, 0.7), (0.9, 1.0), (1.1, 0.7)):
            one = Run(payload, sensor, stop=300.0, length=length, mass=mass)
            yield f"300 s, length x {length:g}, mass x {mass:g}", one


def sizes() -> Iterator[Named]:
    """Ten minutes of cranes of other sizes and payloads, defaults untouched."""
    for length in (0.3, 0.8, 10.0, 50.0):
        for ratio in (0.05, 1.0, 50.0):
            scale = length / Chain().length
            for sensor in NOISE:
                one = Run("", sensor, scale, 600.0, scale=scale, ratio=ratio)
                yield f"{length:g} m of chain, payload {ratio:g} times as heavy", one


def eigenvalues() -> None:
    """The largest growth of the closed loop, 1/s."""
    for payload, sensor in each():
        for length, mass in product((1.0, 0.9, 1.1), (1.0, 0.7, 1.3)):
            run = Run(payload, sensor, length=length, mass=mass)
            control = AntiSway(AntiSwaySettings(run.believed()))
            watch = CraneObserver(ObserverSettings(run.believed(), speed=0.0, sensor=sensor))
            found = stability.predicted_growth(control, watch, run.crane(), H)
            print(
                f"{payload} {sensor}, length x {length:g}, mass x {mass:g}: {found.rate:.1e}"
                f" ({found.omega:.1f} rad/s)"
            )


PARTS = {one.__name__: one for one in (moves, lengths, estimates, pushes, winds, lags, long, sizes)}


def main() -> None:
    """Measure, and print the worst of the seeds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", nargs="*", choices=(*PARTS, "eigenvalues", []), default=[])
    parser.add_argument("--seeds", type=int, help="noise samples a case (10; of long and sizes 1)")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    library()
    with ProcessPoolExecutor(options.workers) as pool:
        for part in options.part or (*PARTS, "eigenvalues"):
            print(f"\n{part}")
            if part == "eigenvalues":
                eigenvalues()
                continue
            cases = list(PARTS[part]())
            seeds = options.seeds or (1 if part in ("long", "sizes") else 10)
            runs = [replace(run, seed=1 + seed) for _, run in cases for seed in range(seeds)]
            found = pool.map(measured, runs)
            for name, run in cases:
                some = list(islice(found, seeds))
                worst = {key: max(one[key] for one in some) for key in some[0]}
                words = ", ".join(f"{key} {value:.3g}" for key, value in worst.items())
                print(f"{run.payload} {run.sensor}, {name}: {words}", flush=True)


if __name__ == "__main__":
    main()
