"""The study of the observer: which model, which sensor, how far off, in closed loop."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from . import plots
from .antisway import HEAVY, LIGHT, Metrics, Setup, estimation_error, listening, measure
from .compare import markdown_table
from .loop import Loop
from .processes import simulate_all
from .tables import Table

PAYLOADS = {"heavy": HEAVY, "light": LIGHT}
OBSERVERS = (0, 1, 2, 5, 10)  # elements; 0: pendulum
SENSORS = ("camera", "rope")
# Factors on the payload's mass that observer and controller believe.
MISJUDGED = (0.7, 0.85, 1.0, 1.15, 1.3)
PUSH = (7.0, 7.5, 0.5)  # s, s, m/s2 by the payload's mass
PUSHED_STOP = 20.0  # s
LONG_STOP = 60.0  # s
AIR = 0.1  # 1/s, unknown to observer and controller
HARD = {
    "antisway": {
        "antisway.scale.position": 0.1,
        "antisway.scale.sway": 0.02,
        "antisway.scale.acceleration": 1.0,
    }
}
STEPS = (0.005, 0.01, 0.02, 0.05)  # s


@dataclass(frozen=True)
class Case:
    """A row of one of the study's tables."""

    table: str
    cells: tuple[str, ...]
    setup: Setup

    def loop(self, fmus: Path) -> Loop:
        """The FMUs to run."""
        if self.table == "stop":
            return listening(self.setup, fmus)
        return self.setup.loop(fmus)


def cases() -> Iterator[Case]:
    """All runs of the study."""
    for label, mass in PAYLOADS.items():
        base = Setup(payload=mass, method="lqr", observer=2)
        for method in ("trapezoid", "zv"):
            yield Case("open", (label, method), replace(base, method=method))
        for sensor in SENSORS:
            for elements in OBSERVERS:
                for noisy in (False, True):
                    one = replace(base, observer=elements, sensor=sensor, noisy=noisy)
                    noise = "noisy" if noisy else "clean"
                    yield Case("loop", (label, sensor, one.label, noise), one)
                one = replace(base, observer=elements, sensor=sensor, noisy=False)
                yield Case("stop", (label, sensor, one.label), one)
        for elements in OBSERVERS:
            one = replace(base, observer=elements, push=PUSH, stop_time=PUSHED_STOP)
            yield Case("push", (label, one.label), one)
        blind = replace(base, method="zv", push=PUSH, stop_time=PUSHED_STOP)
        yield Case("push", (label, "ZV, no feedback"), blind)
        for elements in (0, 2, 10):
            for believed in MISJUDGED:
                one = replace(base, observer=elements, believed=believed)
                off = f"{100 * (believed - 1):+.0f} %" if believed != 1.0 else "0 %"
                yield Case("mass", (label, one.label, off), one)
        for sensor in SENSORS:
            for elements in OBSERVERS:
                one = replace(base, observer=elements, sensor=sensor, more=HARD)
                yield Case("hard", (label, sensor, one.label), one)
        for elements in (0, 2, 10):
            one = replace(base, observer=elements, stop_time=LONG_STOP)
            yield Case("long", (label, one.label), one)
        aired = replace(base, stop_time=LONG_STOP, more={"crane": {"damping.air": AIR}})
        yield Case("long", (label, f"{aired.label}, crane with damping.air {AIR:g} 1/s"), aired)
        for step in STEPS:
            timed = replace(base, step=step, more={"observer": {"sensor.sample_time": step}})
            orders = {
                "one after the other: no delay": replace(timed, order="sequential"),
                "side by side, the step predicted": timed,
                "side by side, the step ignored": replace(timed, late=True),
            }
            for order, one in orders.items():
                yield Case("coupling", (label, f"{1e3 * step:g} ms", order), one)


TITLES = {
    "open": ("Open loop, for comparison", ("payload", "move")),
    "loop": ("Closed loop, 1 m", ("payload", "sensor", "observer", "noise")),
    "mass": ("Payload mass misjudged (rope sensor, noisy)", ("payload", "observer", "believed")),
    "push": (
        "A push on the payload: 0.5 m/s2 times its mass for 0.5 s at 7 s, 20 s in all (rope sensor,"
        " noisy); residual: last 5 s",
        ("payload", "observer"),
    ),
    "hard": (
        "A regulator tuned hard: scales 0.1 m, 0.02 m, 1 m/s2 for 0.2 m, 0.1 m, 0.5 m/s2 (noisy)",
        ("payload", "sensor", "observer"),
    ),
    "long": (
        "A minute long (rope sensor, noisy): what the feedback does to the undamped chain's waves",
        ("payload", "observer"),
    ),
    "coupling": (
        "What the delay of one communication step costs (rope sensor, noisy, 2 elements, sampled"
        " once a step)",
        ("payload", "step", "order of steps"),
    ),
    "stop": (
        "Listening to the paper's sudden stop, no control, no noise, 4 s",
        ("payload", "sensor", "observer"),
    ),
}

PREFACE = """# The linear model as an observer

Written by `chaincrane study observer --out docs`, from the FMUs alone. The plant is `crane_nl.fmu`
with ten elements, undamped, its time step 1 ms; the loop is closed every 10 ms; the move is 1 m
within 0.5 m/s and 1 m/s2, seen for 12 s. Noise is 2 mm (camera) or 0.5 degrees (rope) on each
sample. Errors are of the estimated `payload.x_rel` and `chain.mid_x_rel`, RMS over the whole run;
residual sway is the largest of the last 5 s; the payload settles where it stays within 5 mm of its
target.

The observer with ten elements has the plant's own mesh: its errors are what the linearisation and
the noise cost, and flatter it.
"""

Results = dict[tuple[str, ...], Table]  # by table, then cells


def run(fmus: Path) -> Results:
    """Run the whole study from the FMU files of a folder."""
    all_cases = list(cases())
    tables = simulate_all([case.loop(fmus) for case in all_cases], "study")
    return {(c.table, *c.cells): table for c, table in zip(all_cases, tables, strict=True)}


def picture(results: Results, stem: Path) -> list[Path]:
    """Sway with the plain move and with LQR on three observers, rope sensor, noisy."""
    panels = []
    for label in PAYLOADS:
        runs = [
            (f"LQR, {name}", results["loop", label, "rope", name, "noisy"])
            for name in ("10 elements", "2 elements", "pendulum")
        ]
        panels.append((label, [*runs, ("plain move", results["open", label, "trapezoid"])]))
    return plots.study_figure(panels, stem)


def report(results: Results) -> str:
    """All tables as Markdown."""
    parts = []
    for name, (title, header) in TITLES.items():
        chosen = [(key[1:], table) for key, table in results.items() if key[0] == name]
        if name == "stop":
            columns: tuple[str, ...] = (*header, "payload error, RMS", "middle error, RMS")
            signals = ("payload.x_rel", "chain.mid_x_rel")
            rows = [
                (*key, *(f"{1e3 * estimation_error(table, s):.2f} mm" for s in signals))
                for key, table in chosen
            ]
        else:
            columns = (*header, *Metrics.HEADER)
            rows = [(*key, *measure(table).cells()) for key, table in chosen]
        parts.append(f"## {title}\n\n{markdown_table(columns, rows)}\n")
    return "\n".join(parts)


def summary(results: Results) -> str:
    """docs/observer.md's table: RMS error of the payload's estimate and residual sway, noisy."""
    header = ["observer"]
    header += [f"{label}, {sensor}" for label in PAYLOADS for sensor in SENSORS]
    header += [f"{label}, stop" for label in PAYLOADS]
    rows = []
    for elements in OBSERVERS:
        name = Setup(observer=elements).label
        row = [name]
        for label in PAYLOADS:
            for sensor in SENSORS:
                found = measure(results["loop", label, sensor, name, "noisy"])
                row.append(f"{1e3 * found.payload_rms:.1f} / {1e3 * found.residual:.1f} mm")
        for label in PAYLOADS:
            table = results["stop", label, "camera", name]
            signals = ("payload.x_rel", "chain.mid_x_rel")
            errors = (f"{1e3 * estimation_error(table, signal):.1f}" for signal in signals)
            row.append(" / ".join(errors) + " mm")
        rows.append(row)
    return markdown_table(header, rows)
