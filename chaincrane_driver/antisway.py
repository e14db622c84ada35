"""Runs of the anti-sway loop: what they start from, and what is measured on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import radians
from pathlib import Path
from typing import Any

import numpy as np

from . import shipped
from .compare import markdown_table
from .errors import UserError
from .loop import ANTISWAY, CRANE, OBSERVER, SEPARATOR, Loop, column
from .tables import Table

HEAVY, LIGHT = 0.42, 0.07  # kg, the paper's payloads
TARGET = 1.0  # m
STOP_TIME = 12.0  # s
STEP = 0.01  # s
LAST = 5.0  # s, at the end: where residual sway is looked at
SETTLED = 5e-3  # m
PUSH = (7.0, 7.5, 0.5)  # s, s, m/s2 by the payload's mass
NOISE = {"camera": 0.002, "rope": radians(0.5)}  # m, rad, standard deviations of each sample
# The crane's parameters that observer and controller are told too.
TOLD_TO_ALL = ("chain.length", "chain.mass", "chain.EA", "payload.mass", "gravity")


@dataclass(frozen=True)
class Setup:
    """One run of the loop, in words of the crane rather than of its parts."""

    payload: float = HEAVY  # kg
    plant: str = "crane_nl"
    method: str = "planned"  # or lqr, zv, zvd, time_optimal, trapezoid
    observer: int | None = None  # elements; 0: massless-rope pendulum; None: the string's modes
    sensor: str = "rope"  # or camera
    noisy: bool = True
    believed: float = 1.0  # of the payload's mass, what observer and controller believe
    target: float = TARGET  # m
    stop_time: float = STOP_TIME  # s
    step: float = STEP  # s
    order: str = "parallel"
    late: bool = False  # the controller takes an estimate of the step's start for one of its end
    push: tuple[float, float, float] | None = None  # s, s, m/s2 by the payload's mass
    more: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # start values, by part

    def __post_init__(self) -> None:
        if self.observer is not None and self.observer < 0:
            raise UserError(f"elements = {self.observer} is not allowed: 0 or more, a whole number")

    @property
    def label(self) -> str:
        """The observer's name in tables."""
        if self.observer is None:
            return "string modes"
        if not self.observer:
            return "pendulum"
        return f"{self.observer} element{'s' if self.observer > 1 else ''}"

    def loop(self, fmus: Path) -> Loop:
        """The loop of FMU files in the folder ``fmus``."""
        crane: dict[str, Any] = {"payload.mass": self.payload, "initial.speed": 0.0}
        crane |= self.more.get(CRANE, {})
        shared = {name: crane[name] for name in TOLD_TO_ALL if name in crane}
        shared["payload.mass"] = self.payload * self.believed
        model: dict[str, Any] = {}
        if self.observer is not None:
            model["model"] = "chain" if self.observer else "pendulum"
            model["elements"] = max(1, self.observer)
        late = "end" if self.order == "sequential" or self.late else "start"
        observer = shared | {f"observer.{key}": value for key, value in model.items()}
        observer |= {
            "initial.speed": crane["initial.speed"],
            "observer.sensor": self.sensor,
            "observer.inputs_at": "end" if self.order == "sequential" else "start",
            f"{self.sensor}.noise": NOISE[self.sensor] if self.noisy else 0.0,
        }
        antisway = shared | {f"antisway.{key}": value for key, value in model.items()}
        antisway |= {
            "antisway.method": self.method,
            "antisway.inputs_at": late,
            "target.x": self.target,
        }
        start = {CRANE: crane, OBSERVER: observer, ANTISWAY: antisway}
        files = {CRANE: self.plant, OBSERVER: "crane_observer", ANTISWAY: "crane_antisway"}
        return Loop(
            fmus={part: shipped.fmu(fmus, f"{name}.fmu") for part, name in files.items()},
            start={part: values | dict(self.more.get(part, {})) for part, values in start.items()},
            stop_time=self.stop_time,
            step=self.step,
            order=self.order,
            inputs=None if self.push is None else self._pushed(*self.push),
        )

    def _pushed(self, start: float, end: float, by_mass: float) -> Table:
        table = np.zeros(2, dtype=[("time", float), (column(CRANE, "payload.fx"), float)])
        table["time"] = start, end
        table[column(CRANE, "payload.fx")] = by_mass * self.payload, 0.0
        return table


def listening(setup: Setup, fmus: Path, speed: float = 0.8, stop_at: float = 1.0) -> Loop:
    """The paper's run: crane and observer travel, the trolley stops dead, nobody controls."""
    commands = [column(part, "trolley.v_cmd") for part in (CRANE, OBSERVER)]
    table = np.zeros(2, dtype=[(name, float) for name in ("time", *commands)])
    table["time"] = 0.0, stop_at
    for name in commands:
        table[name] = speed, 0.0
    more = {part: {"initial.speed": speed} | dict(setup.more.get(part, {})) for part in (CRANE,)}
    loop = replace(setup, more=more, stop_time=4.0).loop(fmus)
    parts = {part: loop.fmus[part] for part in (CRANE, OBSERVER)}
    return replace(loop, fmus=parts, inputs=table)


@dataclass(frozen=True)
class Metrics:
    """What is measured on a run."""

    payload_rms: float  # m, of the estimated payload.x_rel's error
    middle_rms: float  # m, of the estimated chain.mid_x_rel's error
    peak: float  # m, largest sway
    residual: float  # m, largest sway in the last 5 s
    settling: float  # s, until the payload stays within 5 mm of the target; nan: it does not
    effort: float  # m/s2, RMS of the command

    HEADER = (
        "payload error, RMS",
        "middle error, RMS",
        "peak sway",
        "residual sway",
        "settles",
        "command, RMS",
    )

    def cells(self) -> list[str]:
        """As a table's cells."""
        lengths = (self.payload_rms, self.middle_rms, self.peak, self.residual)
        settling = "-" if np.isnan(self.settling) else f"{self.settling:.2f} s"
        return [*(f"{1e3 * x:.2f} mm" for x in lengths), settling, f"{self.effort:.3f} m/s2"]


def estimation_error(result: Table, signal: str) -> float:
    """RMS of an estimate's error over the whole run."""
    gap = result[column(OBSERVER, signal)] - result[column(CRANE, signal)]
    return float(np.sqrt(np.mean(gap**2)))


def measure(result: Table, target: float = TARGET) -> Metrics:
    """The metrics of a run of the whole loop."""
    time, sway = result["time"], result[column(CRANE, "payload.x_rel")]
    outside = np.flatnonzero(np.abs(result[column(CRANE, "payload.x")] - target) > SETTLED)
    last = int(outside[-1]) if len(outside) else -1
    settling = float("nan") if last == len(time) - 1 else float(time[last + 1])
    return Metrics(
        payload_rms=estimation_error(result, "payload.x_rel"),
        middle_rms=estimation_error(result, "chain.mid_x_rel"),
        peak=float(np.abs(sway).max()),
        residual=float(np.abs(sway[time >= time[-1] - LAST]).max()),
        settling=settling,
        effort=float(np.sqrt(np.mean(result[column(ANTISWAY, "trolley.a_cmd")] ** 2))),
    )


def metrics_table(first: str, rows: list[tuple[str, Metrics]]) -> str:
    """Metrics as Markdown, a row a run."""
    return markdown_table((first, *Metrics.HEADER), [(name, *one.cells()) for name, one in rows])


def parse_setting(text: str) -> tuple[str, str, Any]:
    """A start value of a part, as PART::NAME=VALUE. Raises UserError."""
    name, equals, value = text.partition("=")
    part, separator, variable = name.partition(SEPARATOR)
    if not equals or not separator or part not in (CRANE, OBSERVER, ANTISWAY):
        example = f"{OBSERVER}{SEPARATOR}sensor.delay=0.02"
        raise UserError(f"{text!r} is not a setting like {example}")
    for kind in (int, float):
        try:
            return part, variable, kind(value)
        except ValueError:
            continue
    return part, variable, value
