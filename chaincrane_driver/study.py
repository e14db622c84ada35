"""The study of the closed loop: which move, which model for the observer, which sensor, what size.

The plant has 40 elements, more than any observer of the study. Runs that are compared are paired:
they share noise, payload and what is wrongly believed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np

from . import plots
from .antisway import HEAVY, LIGHT, NOISE, PUSH, Setup, estimation_error
from .compare import markdown_table
from .loop import ANTISWAY, CRANE, OBSERVER, Loop, Series, column
from .processes import simulate_all
from .tables import Table

PAYLOADS = {"heavy": HEAVY, "light": LIGHT}
SENSORS = ("camera", "rope")
MODELS = (None, 10, 5, 2, 1, 0)  # elements; None: string modes, 0: pendulum
FED_BACK = ("planned", "lqr")
OPEN = ("time_optimal", "zv", "zvd", "trapezoid")
SEEDS = (1, 2, 3)
SAMPLES = 5
MASS_OFF, LENGTH_OFF = 0.3, 0.1  # what is believed is wrong by at most that much
PUSHED_STOP = 20.0  # s
LONG_STOP = 300.0  # s
SIZES = (0.3, 0.8, 10.0, 50.0)  # m of chain
RATIOS = (0.05, 1.0, 50.0)  # payload by chain
LENGTH, MASS = 0.8, 0.22  # m, kg, the chain whose runs all sizes are scaled from
PLANT = {"chain.elements": 40, "solver.max_step": 0.002}
SETTLED = 5e-3 / LENGTH  # of the length


@dataclass(frozen=True)
class Case:
    """One run: its table, its row there, and its number in the row."""

    table: str
    row: tuple[str, ...]
    setup: Setup
    size: float = LENGTH  # m of chain

    def loop(self, fmus: Path) -> Loop:
        """The FMUs to run: an observer where it is fed back, none beside a move in open loop."""
        loop = self.setup.loop(fmus)
        if self.setup.method in FED_BACK:
            return loop
        parts = {part: file for part, file in loop.fmus.items() if part != OBSERVER}
        return replace(loop, fmus=parts)


def _told(setup: Setup, plant: dict[str, Any], seed: int, believed: dict[str, Any]) -> Setup:
    """A setup on the study's plant, with a seed and what observer and controller believe."""
    more = {
        CRANE: PLANT | plant,
        OBSERVER: {"sensor.seed": seed} | believed,
        ANTISWAY: dict(believed),
    }
    return replace(setup, more=more)


def moves() -> Iterator[Case]:
    """The same metre by every method."""
    for label, mass in PAYLOADS.items():
        for method in OPEN:
            one = Setup(mass, method=method)
            yield Case("moves", (label, method, "none"), _told(one, {}, 1, {}))
        for method in FED_BACK:
            for sensor in SENSORS:
                for seed in SEEDS:
                    one = Setup(mass, method=method, sensor=sensor)
                    yield Case("moves", (label, method, sensor), _told(one, {}, seed, {}))


def models() -> Iterator[Case]:
    """Every model on the same random samples of noise and of what is wrongly believed."""
    generator = np.random.default_rng(1)
    for number in range(SAMPLES):
        mass_off, length_off = generator.uniform(-1.0, 1.0, 2) * (MASS_OFF, LENGTH_OFF)
        for label, mass in PAYLOADS.items():
            believed = {"chain.length": LENGTH * (1.0 + length_off)}
            for sensor in SENSORS:
                for elements in MODELS:
                    one = Setup(
                        mass, observer=elements, sensor=sensor, believed=1.0 + float(mass_off)
                    )
                    sample = _told(one, {}, number + 10, believed)
                    yield Case("models", (label, sensor, one.label), sample)


def pushes() -> Iterator[Case]:
    """A push on the payload after the move."""
    for label, mass in PAYLOADS.items():
        for method in (*FED_BACK, "zv"):
            for sensor in SENSORS if method in FED_BACK else ("none",):
                one = Setup(mass, method=method, push=PUSH, stop_time=PUSHED_STOP)
                one = replace(one, sensor=sensor if sensor != "none" else "rope")
                yield Case("pushes", (label, method, sensor), _told(one, {}, 1, {}))


def long_runs() -> Iterator[Case]:
    """Five minutes, nothing damped anywhere."""
    for label, mass in PAYLOADS.items():
        for sensor in SENSORS:
            one = Setup(mass, sensor=sensor, stop_time=LONG_STOP)
            yield Case("long", (label, sensor), _told(one, {}, 1, {}))


def sizes() -> Iterator[Case]:
    """The same move from a lab crane to a harbour crane: all lengths and times scaled with it.

    Defaults untouched: limits of velocity alone follow the size, as drives do.
    """
    for length in SIZES:
        scale = length / LENGTH
        for ratio in RATIOS:
            mass = MASS * scale**2
            for method, sensors in (("time_optimal", ("none",)), ("planned", SENSORS)):
                for sensor in sensors:
                    one = Setup(
                        ratio * mass,
                        method=method,
                        sensor=sensor if sensor != "none" else "rope",
                        target=scale,
                        stop_time=round(12.0 * sqrt(scale), 2),
                    )
                    plant = {"chain.length": length, "chain.mass": mass}
                    plant["chain.EA"] = 7.357e6 * scale**2
                    told = _told(one, plant, 1, {})
                    drive = {"limit.velocity": 0.5 * sqrt(scale)}
                    camera = {"camera.noise": NOISE["camera"] * scale}
                    watch = dict(told.more[OBSERVER]) | (camera if sensor == "camera" else {})
                    more = dict(told.more) | {OBSERVER: watch, ANTISWAY: drive}
                    row = (f"{length:g} m", f"{ratio:g}", method, sensor)
                    yield Case("sizes", row, replace(told, more=more), length)


def cases() -> Iterator[Case]:
    """All runs of the study."""
    for part in (moves, models, pushes, long_runs, sizes):
        yield from part()


@dataclass(frozen=True)
class Measured:
    """What is measured on a run."""

    settling: float  # s; nan: it does not settle
    residual: float  # m, largest sway in the last 5 s of 12
    peak: float  # m
    estimate: float  # m, RMS error of payload.x_rel; nan: no observer
    middle: float  # m, RMS error of chain.mid_x_rel; nan: no observer
    velocity: float  # m/s, largest
    acceleration: float  # m/s2, largest
    minutes: tuple[float, float]  # m, largest sway in the second minute and in the last


def measured(case: Case, table: Table) -> Measured:
    """Measure a run; a payload within 5 mm of 0.8 m, by size, has settled."""
    time, sway = table["time"], np.abs(table[column(CRANE, "payload.x_rel")])
    off = np.abs(table[column(CRANE, "payload.x")] - case.setup.target)
    outside = np.flatnonzero(off > SETTLED * case.size)
    last = int(outside[-1]) if len(outside) else -1
    late = time >= time[-1] - 5.0 / 12.0 * min(
        case.setup.stop_time, 12.0 * sqrt(case.size / LENGTH)
    )
    second = (time >= 60.0) & (time < 120.0)
    watched = case.setup.method in FED_BACK
    return Measured(
        settling=float("nan") if last == len(time) - 1 else float(time[last + 1]),
        residual=float(sway[late].max()),
        peak=float(sway.max()),
        estimate=estimation_error(table, "payload.x_rel") if watched else float("nan"),
        middle=estimation_error(table, "chain.mid_x_rel") if watched else float("nan"),
        velocity=float(np.abs(table[column(CRANE, "trolley.v")]).max()),
        acceleration=float(np.abs(table[column(ANTISWAY, "trolley.a_cmd")]).max()),
        minutes=(
            float(sway[second].max()) if second.any() else 0.0,
            float(sway[time >= time[-1] - 60.0].max()),
        ),
    )


@dataclass(frozen=True)
class Results:
    """All that was measured, by table and row, and the runs that the picture shows."""

    found: dict[str, dict[tuple[str, ...], list[Measured]]]
    shown: dict[tuple[str, ...], Table]


def files(fmus: Path) -> set[Path]:
    """The FMU files that the study runs."""
    return {file for case in cases() for file in case.loop(fmus).fmus.values()}


def tables_of(loops: Sequence[Loop]) -> list[Table]:
    """Run the loops, those of one controller as a series, the longest series first."""
    alike: dict[Any, list[int]] = {}
    for place, loop in enumerate(loops):
        alike.setdefault(tuple(sorted(loop.start[ANTISWAY].items())), []).append(place)
    series = {tuple(places): Series([loops[k] for k in places]) for places in alike.values()}
    order = sorted(series, key=lambda places: series[places].stop_time, reverse=True)
    done = simulate_all([series[places] for places in order], "study")
    tables = {
        place: table
        for places, results in zip(order, done, strict=True)
        for place, table in zip(places, results, strict=True)
    }
    return [tables[place] for place in range(len(loops))]


def run(fmus: Path) -> Results:
    """Run the whole study from the FMU files of a folder."""
    every = list(cases())
    tables = tables_of([case.loop(fmus) for case in every])
    found: dict[str, dict[tuple[str, ...], list[Measured]]] = {}
    shown: dict[tuple[str, ...], Table] = {}
    for case, table in zip(every, tables, strict=True):
        found.setdefault(case.table, {}).setdefault(case.row, []).append(measured(case, table))
        if case.table == "moves":
            shown.setdefault(case.row, table)
    return Results(found, shown)


def spread(values: Sequence[float], factor: float = 1.0, digits: int = 2) -> str:
    """Median, and lowest to highest where there are several."""
    scaled = [factor * value for value in values]
    if any(np.isnan(scaled)):
        settled = [value for value in scaled if not np.isnan(value)]
        return f"{len(settled)} of {len(scaled)} settle" if len(scaled) > 1 else "-"
    told = [float(np.median(scaled)), min(scaled), max(scaled)]
    middle, low, high = (f"{round(value, digits) + 0.0:.{digits}f}" for value in told)  # no -0.0
    return middle if len(scaled) == 1 else f"{middle} ({low} to {high})"


def _moves(results: Results) -> str:
    rows = []
    for row, found in results.found["moves"].items():
        settling = spread([one.settling for one in found])
        residual = spread([one.residual for one in found], 1e3)
        peak = spread([one.peak for one in found], 1e3, 0)
        v, a = max(one.velocity for one in found), max(one.acceleration for one in found)
        rows.append((*row, settling, residual, peak, f"{v:.3f}", f"{a:.3f}"))
    header = ("payload", "method", "sensor", "settles, s", "residual, mm", "peak sway, mm")
    return markdown_table((*header, "largest v, m/s", "largest a, m/s2"), rows)


def _models(results: Results) -> str:
    found, rows = results.found["models"], []
    for (label, sensor, model), ours in found.items():
        best = found[label, sensor, "string modes"]
        more = [one.residual - other.residual for one, other in zip(ours, best, strict=True)]
        rows.append(
            (
                label,
                sensor,
                model,
                spread([one.estimate for one in ours], 1e3),
                spread([one.middle for one in ours], 1e3),
                spread([one.residual for one in ours], 1e3),
                "" if model == "string modes" else spread(more, 1e3),
            )
        )
    header = ("payload", "sensor", "observer", "payload error, mm", "middle error, mm")
    return markdown_table((*header, "residual, mm", "more than string modes, mm"), rows)


def _pushes(results: Results) -> str:
    rows = []
    for row, found in results.found["pushes"].items():
        back = spread([one.settling - PUSH[1] for one in found])
        rows.append((*row, back, spread([one.residual for one in found], 1e3)))
    header = ("payload", "method", "sensor", "back within 5 mm after, s", "residual, mm")
    return markdown_table(header, rows)


def _long(results: Results) -> str:
    rows = []
    for row, found in results.found["long"].items():
        second, last = (1e3 * value for value in found[0].minutes)
        rows.append((*row, f"{second:.2f}", f"{last:.2f}"))
    header = ("payload", "sensor", "sway in the second minute, mm", "in the fifth, mm")
    return markdown_table(header, rows)


def _sizes(results: Results) -> str:
    found, rows = results.found["sizes"], []
    for (length, ratio, method, sensor), (one,) in found.items():
        if method == "time_optimal":
            continue
        (limit,) = found[length, ratio, "time_optimal", "none"]
        fair = limit.settling <= one.settling  # else the waves of a bare chain ring on open loop
        size = float(length.split()[0])
        rows.append(
            (
                length,
                ratio,
                sensor,
                spread([limit.settling]) if fair else "rings on",
                spread([one.settling]),
                f"{one.settling / limit.settling:.2f}" if fair else "",
                f"{100.0 * one.residual / size:.2f}",
            )
        )
    header = ("chain", "payload by chain", "sensor", "time-optimal, s", "planned, s", "ratio")
    return markdown_table((*header, "residual, % of the length"), rows)


def answer(results: Results) -> str:
    """What the tables say, in sentences made of their numbers."""
    moves, models = results.found["moves"], results.found["models"]

    def settle(label: str, method: str) -> str:
        every = [m for (p, d, _), ms in moves.items() if (p, d) == (label, method) for m in ms]
        return spread([one.settling for one in every])

    lines = []
    for label in PAYLOADS:
        lines.append(
            f"- {label.capitalize()} payload, 1 m: `planned` settles in"
            f" {settle(label, 'planned')} s, `lqr` in {settle(label, 'lqr')} s; open loop the"
            f" time-optimal move takes {settle(label, 'time_optimal')} s, ZV"
            f" {settle(label, 'zv')} s."
        )
    for label in PAYLOADS:
        parts = []
        for model in ("10 elements", "5 elements", "2 elements", "1 element", "pendulum"):
            more = [
                1e3 * (ours.residual - best.residual)
                for sensor in SENSORS
                for ours, best in zip(
                    models[label, sensor, model], models[label, sensor, "string modes"], strict=True
                )
            ]
            parts.append(f"{model} {spread(more, digits=1)} mm")
        lines.append(
            f"- How few elements serve, {label} payload, mass and length believed wrongly: residual"
            f" sway beyond that of the string's own modes: {', '.join(parts)}."
        )
    pushed = {row: found[0].settling - PUSH[1] for row, found in results.found["pushes"].items()}
    for label in PAYLOADS:
        times = ", ".join(
            f"{pushed[label, 'planned', sensor]:.1f} s ({sensor})" for sensor in SENSORS
        )
        lines.append(f"- {label.capitalize()} payload, after a push: back within 5 mm in {times}.")
    ratios = [
        one.settling / found_limit.settling
        for (length, ratio, method, _), (one,) in results.found["sizes"].items()
        if method == "planned"
        for found_limit in results.found["sizes"][length, ratio, "time_optimal", "none"]
        if found_limit.settling <= one.settling
    ]
    lines.append(
        f"- From {SIZES[0]:g} to {SIZES[-1]:g} m of chain, with untouched defaults, the plan takes"
        f" at most {max(ratios):.2f} times what the time-optimal move takes, where that settles."
    )
    second, fifth = (
        1e3 * max(found[0].minutes[place] for found in results.found["long"].values())
        for place in (0, 1)
    )
    lines.append(
        f"- Without any damping the sway is at most {second:.2f} mm in the second minute and"
        f" {fifth:.2f} mm in the fifth: what the sensor's noise makes, and no more of it with time."
    )
    return "\n".join(lines)


PREFACE = """# The closed loop: a study

Written by `chaincrane study observer --out docs`, from the FMUs alone.

## The answer

"""
HOW = f"""## How

The plant is `crane_nl.fmu` with {PLANT["chain.elements"]} elements, undamped, its time step
2 ms; no observer has its mesh. The loop is closed every 10 ms; the move is 1 m within 0.5 m/s and
1 m/s2, seen for 12 s. Noise is 2 mm (camera) or 0.5 degrees (rope) on each sample. The payload
settles where it stays within 5 mm of its target; residual sway is the largest of the last 5 s;
errors are of the estimated `payload.x_rel` and `chain.mid_x_rel`, RMS over the whole run. Where
there are several runs a cell has their median, and the lowest to the highest. Random samples are
paired: the rows of one payload and sensor share the noise and what is wrongly believed, the
payload's mass by up to {100 * MASS_OFF:.0f} % and the chain's length by up to
{100 * LENGTH_OFF:.0f} %; the last column of their table is of the differences within pairs. For
the sizes, lengths, the camera's noise and the velocity limit follow the chain (times with the root
of it); everything else is as it comes.
"""


def report(results: Results) -> str:
    """The page: the answer, the tables, how it was done."""
    parts = [
        ("Methods: the same metre", _moves),
        (f"Models: how few elements serve ({SAMPLES} paired samples)", _models),
        ("A push of 0.5 m/s2 by the payload's mass, for 0.5 s, after the move", _pushes),
        ("Five minutes", _long),
        ("Sizes", _sizes),
    ]
    tables = "\n\n".join(f"## {title}\n\n{table(results)}" for title, table in parts)
    return f"{PREFACE}{answer(results)}\n\n{tables}\n\n{HOW}"


def picture(results: Results, stem: Path) -> list[Path]:
    """Payload's way and command of the plan, of LQR and of two open-loop moves; rope sensor."""
    panels = []
    for label in PAYLOADS:
        runs = [
            ("plan and regulator", results.shown[label, "planned", "rope"]),
            ("LQR", results.shown[label, "lqr", "rope"]),
            ("ZV-shaped", results.shown[label, "zv", "none"]),
            ("time-optimal", results.shown[label, "time_optimal", "none"]),
        ]
        panels.append((label, runs))
    return plots.study_figure(panels, stem)
