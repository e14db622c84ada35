"""Differences: between models of one scenario, and between a result and its reference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .errors import UserError, instead
from .instances import Instances
from .progress import Progress
from .scenario import Run, Scenario, checked_rules, read_toml
from .shipped import TOLERANCES
from .simulate import Job
from .tables import Table, read_table

IN_THOUSANDTHS = ("m", "m/s", "rad")  # shown in mm, mm/s, mrad
COST = ("solver.steps", "solver.iterations")  # what a run costs, not what it gives


@dataclass(frozen=True)
class Difference:
    """How far one run's signal is from the first run's."""

    signal: str
    rms: float
    largest: float
    amplitude: float  # largest absolute value of the first run's signal

    @property
    def rms_percent(self) -> float:
        """RMS difference in per cent of the amplitude."""
        return 100.0 * self.rms / self.amplitude if self.amplitude else float("nan")

    @property
    def largest_percent(self) -> float:
        """Largest difference in per cent of the amplitude."""
        return 100.0 * self.largest / self.amplitude if self.amplitude else float("nan")


def difference(truth: Table, other: Table, signal: str) -> Difference:
    """Difference of ``signal`` between two runs on the same times."""
    gap = other[signal] - truth[signal]
    return Difference(
        signal,
        float(np.sqrt(np.mean(gap**2))),
        float(np.max(np.abs(gap))),
        float(np.max(np.abs(truth[signal]))),
    )


def shown(unit: str | None) -> tuple[float, str]:
    """Factor and name of the unit that values of ``unit`` are shown in: lengths in mm."""
    if unit in IN_THOUSANDTHS:
        return 1e3, f"m{unit}"
    return 1.0, (unit or "").replace("m/s2", "m/s\N{SUPERSCRIPT TWO}").replace("N.s", "N s")


Rows = tuple[Sequence[str], list[Sequence[str]]]  # a table's header, and its rows


def comparison_table(
    scenario: Scenario, results: dict[str, Table], units: Mapping[str, str | None]
) -> str:
    """RMS and largest difference to the first run, for each signal looked at, as Markdown.

    Of one run alone: how large each signal is.
    """
    return markdown_table(*comparison_rows(scenario, results, units, scenario.look_at))


def comparison_rows(
    scenario: Scenario,
    results: Mapping[str, Table],
    units: Mapping[str, str | None],
    alone: Sequence[str],
) -> Rows:
    """The same as a header and rows; ``alone``: the signals that are told of one run."""
    first, *others = scenario.runs
    if not others:
        return _size_rows(results[first.name], alone, units)
    header = ("signal", f"against {first.label}", "RMS", "largest", "RMS", "largest")
    rows: list[Sequence[str]] = []
    for signal in scenario.look_at:
        factor, unit = shown(units[signal])
        for run in others:
            gap = difference(results[first.name], results[run.name], signal)
            rows.append(
                (
                    signal,
                    run.label,
                    f"{factor * gap.rms:.2f} {unit}",
                    f"{factor * gap.largest:.2f} {unit}",
                    f"{gap.rms_percent:.2f} %",
                    f"{gap.largest_percent:.2f} %",
                )
            )
    return header, rows


def _size_rows(result: Table, signals: Sequence[str], units: Mapping[str, str | None]) -> Rows:
    rows: list[Sequence[str]] = []
    for signal in signals:
        factor, unit = shown(units[signal])
        sizes = np.abs(result[signal]).max(), np.sqrt(np.mean(result[signal] ** 2))
        rows.append((signal, *(f"{factor * size:.4g} {unit}".rstrip() for size in sizes)))
    return ("signal", "largest", "RMS"), rows


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table whose columns line up."""
    widths = [max(len(row[i]) for row in [header, *rows]) for i in range(len(header))]

    def line(cells: Sequence[str]) -> str:
        return "| " + " | ".join(c.ljust(w) for c, w in zip(cells, widths, strict=True)) + " |"

    rule = ["-" * width for width in widths]
    return "\n".join([line(header), line(rule), *map(line, rows)])


def reference_rows(scenario: Scenario, result: Table) -> Table:
    """The rows and signals of a result that are kept as reference."""
    places = result["time"] / scenario.reference_interval
    kept = result[np.abs(places - np.round(places)) < 1e-6]
    assert kept.dtype.names is not None
    names = [name for name in kept.dtype.names if name not in COST]
    table = np.zeros(len(kept), dtype=[(name, float) for name in names])
    for name in names:
        table[name] = kept[name]
    return table


@dataclass(frozen=True)
class Tolerance:
    """What a signal may differ from its reference by, and why."""

    absolute: float
    reason: str


def tolerances(scenario: Scenario) -> dict[str, Tolerance]:
    """Tolerances by pattern of signal names: the common file's, overridden by the scenario's.

    The common file stands beside the scenario's folder; where there is none, ours counts.
    """
    beside = scenario.folder.parent / "tolerances.toml"
    common = beside if beside.exists() else TOLERANCES
    rules = checked_rules(common, read_toml(common)) | scenario.tolerance
    return {
        pattern: Tolerance(float(rule["absolute"]), rule["reason"])
        for pattern, rule in rules.items()
    }


@dataclass(frozen=True)
class Deviation:
    """How far a signal is from its reference."""

    signal: str
    largest: float
    when: float  # s
    first: float | None  # s, when it first left the tolerance; None: it never did
    tolerance: Tolerance

    @property
    def within(self) -> bool:
        """Is it as its reference?"""
        return self.first is None

    @property
    def share(self) -> float:
        """Of what it may differ by: above 1 it differs."""
        if np.isnan(self.largest):
            return float("inf")
        if not self.tolerance.absolute:
            return float("inf") if self.largest else 0.0
        return self.largest / self.tolerance.absolute

    def __str__(self) -> str:
        return (
            f"{self.signal}: off by {self.largest:.3g} at t = {self.when:g} s, beyond"
            f" {self.tolerance.absolute:.3g} ({self.tolerance.reason}) from t = {self.first:g} s"
        )


def deviation(
    signal: str, time: NDArray[np.float64], gap: NDArray[np.float64], tolerance: Tolerance
) -> Deviation:
    """The deviation of a signal whose differences to its reference are ``gap``, by time."""
    outside = ~(gap <= tolerance.absolute)  # not a number is outside
    worst = int(np.argmax(np.where(np.isnan(gap), np.inf, gap)))
    first = float(time[np.argmax(outside)]) if outside.any() else None
    return Deviation(signal, float(gap[worst]), float(time[worst]), first, tolerance)


def check(scenario: Scenario, run: Run, result: Table, reference: Table) -> list[Deviation]:
    """The signals of a result that are not as in its reference; an empty list is good news."""
    found = deviations(scenario, run, result, reference)
    return [one for one in found if not one.within]


def deviations(scenario: Scenario, run: Run, result: Table, reference: Table) -> list[Deviation]:
    """Compare a result with its reference, signal by signal. Raises UserError."""
    path = scenario.reference(run)
    rows = reference_rows(scenario, result)
    if len(rows) != len(reference) or np.abs(rows["time"] - reference["time"]).max() > 1e-9:
        raise UserError(f"{path}: its times are not the scenario's; renew it with --update")
    rules = tolerances(scenario)
    assert reference.dtype.names is not None and rows.dtype.names is not None
    for pattern in scenario.tolerance:
        if not any(_fits(pattern, name) for name in rows.dtype.names):
            near = instead(pattern, rows.dtype.names)
            where = scenario.folder / "scenario.toml"
            raise UserError(f"{where}: tolerance: {pattern!r} fits no signal{near}")
    for name in reference.dtype.names:
        if name not in rows.dtype.names:
            raise UserError(f"{path}: the FMU has no output {name!r}")
    for name in rows.dtype.names:
        if name not in reference.dtype.names:
            raise UserError(f"{path}: has no column {name!r}; renew it with --update")
    return [
        deviation(
            name, rows["time"], np.abs(rows[name] - reference[name]), _tolerance(rules, name, path)
        )
        for name in reference.dtype.names[1:]
    ]


def against_reference(scenario: Scenario, run: Run, result: Table) -> list[Deviation]:
    """Compare a result with the frozen one of its run, signal by signal. Raises UserError."""
    path = scenario.reference(run)
    if not path.exists():
        raise UserError("has no reference; make one with --update")
    return deviations(scenario, run, result, read_table(path))


@dataclass(frozen=True)
class Comparison:
    """A run and its comparison as a worker's work: what travels back is no series."""

    scenario: Scenario
    of: Run
    job: Job

    @property
    def name(self) -> str:
        """What messages call it."""
        return self.job.name

    @property
    def stop_time(self) -> float:
        """Simulated time, s."""
        return self.job.stop_time

    def run(self, instances: Instances, progress: Progress | None = None) -> list[Deviation]:
        """Simulate in this process, and compare with the reference. Raises UserError."""
        return against_reference(self.scenario, self.of, self.job.run(instances, progress))


def _fits(pattern: str, name: str) -> bool:
    """Does a rule's pattern fit a signal? '*' stands for anything, brackets for themselves."""
    return fnmatchcase(name, pattern.replace("[", "[[]"))


def _tolerance(rules: dict[str, Tolerance], name: str, path: Path) -> Tolerance:
    """The last rule that fits a signal's name."""
    fitting = [rule for pattern, rule in rules.items() if _fits(pattern, name)]
    if not fitting:
        raise UserError(f"{path}: no tolerance is given for {name!r}")
    return fitting[-1]
