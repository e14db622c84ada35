"""A report: one HTML file with the crane moving, its curves, differences and settings.

It needs no network: what is drawn and what draws it are all in the file.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib import metadata
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from . import shipped
from .antisway import Metrics, Setup, measure
from .compare import comparison_rows, shown
from .instances import describe
from .loop import CRANE, OBSERVER, WATCHED, Loop, column
from .places import whole_file
from .scenario import Scenario
from .tables import Table

TEMPLATE = Path(__file__).with_name("report.html")
POINTS = 10  # of the chain, that the FMU tells
PLACE = 1e-4  # m, what places are rounded to; no screen shows less
DIGITS = 5  # of a curve's values
ROWS = 1500  # at most, of a run
SHAPE = (
    "trolley.x",
    *(f"chain.{axis}[{i}]" for axis in "xy" for i in range(1, POINTS + 1)),
)
ALSO = ("trolley.v", "chain.tension_top")  # besides what a scenario looks at


@dataclass(frozen=True)
class Curve:
    """A signal of some runs: values by run, None where a run has it not."""

    title: str
    unit: str
    values: Sequence[np.ndarray | None]


@dataclass(frozen=True)
class Report:
    """What a report tells.

    ``runs``: label and result of each, whose columns are named ``prefix`` and a variable.
    """

    title: str
    asks: str
    heading: str  # of the table
    table: tuple[Sequence[str], Sequence[Sequence[str]]]
    settings: Sequence[tuple[str, str]]
    runs: Sequence[tuple[str, Table]]
    curves: Sequence[Curve]
    prefix: str = ""

    def write(self, path: Path) -> Path:
        """Write it as one HTML file; its path."""
        text = Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
            title=escape(self.title),
            asks=escape(self.asks),
            heading=escape(self.heading),
            differences=_html_table(*self.table),
            settings=_html_table(("what", "value"), self.settings),
            data=json.dumps(self._data(), separators=(",", ":")).replace("<", "\\u003c"),
        )
        with whole_file(path) as partial:
            partial.write_text(text, encoding="utf-8")
        return path

    def _data(self) -> dict[str, Any]:
        time = self.runs[0][1]["time"]
        rows = slice(None, None, max(1, -(-len(time) // ROWS)))
        return {
            "time": np.round(time[rows], 6).tolist(),
            "runs": [
                {
                    "label": label,
                    "x": self._places(table[rows], "x"),
                    "y": self._places(table[rows], "y"),
                }
                for label, table in self.runs
            ],
            "signals": [
                {
                    "title": curve.title,
                    "unit": curve.unit,
                    "digits": _digits(curve.values),
                    "values": [None if v is None else _rounded(v[rows]) for v in curve.values],
                }
                for curve in self.curves
            ],
        }

    def _places(self, table: Table, axis: str) -> list[list[int]]:
        """The trolley's point and the chain's, in units of ``PLACE``, by row."""
        at_trolley = table[self.prefix + "trolley.x"] if axis == "x" else np.zeros(len(table))
        names = [f"{self.prefix}chain.{axis}[{i}]" for i in range(1, POINTS + 1)]
        columns = np.column_stack([at_trolley, *(table[name] for name in names)])
        return [[int(place) for place in row] for row in np.rint(columns / PLACE)]


def _rounded(values: np.ndarray) -> list[float]:
    return [float(f"{value:.{DIGITS}g}") for value in values]


def _digits(curves: Iterable[np.ndarray | None]) -> int:
    """Digits behind the point that tell a thousandth of the largest value."""
    most = max((float(np.abs(v).max()) for v in curves if v is not None), default=1.0)
    return 0 if most == 0 else int(np.clip(3 - np.floor(np.log10(most)), 0, 12))


def _html_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    def line(cells: Sequence[str], tag: str) -> str:
        texts = (escape(cell.replace("m/s2", "m/s\N{SUPERSCRIPT TWO}")) for cell in cells)
        return "<tr>" + "".join(f"<{tag}>{text}</{tag}>" for text in texts) + "</tr>"

    body = [line(header, "th"), *(line(row, "td") for row in rows)]
    return "<table>\n" + "\n".join(body) + "\n</table>"


def _versions(fmus: Iterable[Path]) -> list[tuple[str, str]]:
    """What was run: each FMU's file and guid, and by which programs."""
    told = [(fmu.name, str(describe(fmu).guid)) for fmu in dict.fromkeys(fmus)]
    names = ("chaincrane", "fmpy")
    return [*told, ("driven by", ", ".join(f"{name} {metadata.version(name)}" for name in names))]


def _start_values(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} = {value}" for name, value in values.items()) or "the FMU's own"


def of_scenario(
    one: Scenario, results: Mapping[str, Table], units: Mapping[str, str | None], fmus: Path
) -> Report:
    """The report of a scenario's runs."""
    runs = one.runs
    names = dict.fromkeys([*one.look_at, *(name for name in ALSO if name in units)])
    curves = []
    for name in names:
        factor, unit = shown(units[name])
        values = [factor * results[run.name][name] for run in runs]
        curves.append(Curve(f"{name}, {unit}" if unit else name, unit, values))
    settings = [
        ("simulated", f"{one.stop_time:g} s, an output every {one.output_interval:g} s"),
        ("all runs start with", _start_values(one.start)),
        *((run.label, f"{run.fmu}: {_start_values(run.start)}") for run in runs),
        *_versions(shipped.fmu(fmus, run.fmu) for run in runs),
    ]
    return Report(
        one.title,
        " ".join(one.asks.split()),
        f"Differences to: {runs[0].label}" if len(runs) > 1 else "How large",
        comparison_rows(one, results, units, list(names)),
        settings,
        [(run.label, results[run.name]) for run in runs],
        curves,
    )


def with_shape(loop: Loop) -> Loop:
    """The same loop, its result with the chain's points."""
    names = dict.fromkeys([*WATCHED[CRANE], *SHAPE])
    return Loop(**{**loop.__dict__, "watched": {**loop.watched, CRANE: tuple(names)}})


def of_antisway(setup: Setup, loop: Loop, runs: Sequence[tuple[str, Table]], title: str) -> Report:
    """The report of the closed loop and of the moves that it is compared with."""

    def curve(text: str, unit: str, factor: float, name: str) -> Curve:
        return Curve(f"{text}, {unit}", unit, [factor * table[name] for _, table in runs])

    first = runs[0][1]
    sway = column(CRANE, "payload.x_rel")
    gap = 1e3 * (first[column(OBSERVER, "payload.x_rel")] - first[sway])
    nobody: list[np.ndarray | None] = [None] * (len(runs) - 1)
    rows = [(label, *measure(table, setup.target).cells()) for label, table in runs]
    return Report(
        title,
        "The crane moves; observer and controller are FMUs too, beside them moves in open loop.",
        "What is measured",
        (("move", *Metrics.HEADER), rows),
        [
            ("simulated", f"{loop.stop_time:g} s, the loop closed every {1e3 * loop.step:g} ms"),
            *((part, _start_values(values)) for part, values in loop.start.items()),
            *_versions(loop.fmus.values()),
        ],
        runs,
        [
            curve("position of the payload: payload.x", "m", 1.0, column(CRANE, "payload.x")),
            curve("sway: payload.x_rel", "mm", 1e3, sway),
            Curve("error of the estimated sway, mm", "mm", [gap, *nobody]),
            curve("velocity of the trolley: trolley.v", "m/s", 1.0, column(CRANE, "trolley.v")),
        ],
        column(CRANE, ""),
    )
