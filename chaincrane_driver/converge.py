"""How big the time error and the mesh error of a run are, from runs of its FMU alone.

The FMU runs as the scenario asks, then with its internal step halved twice, then with its elements
doubled twice. The differences of such three runs give the order of convergence and the error of the
first (Richardson). What holding an input over a communication step costs is in neither error.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil, isfinite, log2
from pathlib import Path

import numpy as np
from fmpy.model_description import ModelDescription, ScalarVariable
from numpy.typing import NDArray

from . import shipped
from .compare import markdown_table, shown
from .errors import UserError, instead
from .instances import Instances, describe
from .places import whole_file
from .processes import simulate_all
from .progress import Progress
from .scenario import Run, Scenario
from .simulate import Job
from .tables import Table, column_names

STEP, ELEMENTS, LENGTH = "solver.max_step", "chain.elements", "chain.length"
BESIDES = ("payload.vx", "payload.vy", "chain.top_angle", "chain.tension_top", "trolley.fx")
REFINED = (2, 4)  # times as many steps, and as many elements, as the scenario's own run
# Between these an order is believed. With an order below 0.9 the extrapolation was up to 3.6 times
# too large in the scenarios; the difference to the finest run was right within a factor of about 2,
# but for forces that are not predictable.
ORDERS = (0.9, 4.5)
# Where runs converge, the second difference is below so much of the first: largest and RMS.
SHRINK_LARGEST, SHRINK_RMS = 0.8, 0.6
MATTERS = 0.01  # of a signal's scale: a difference below it is small, predictable or not
SWAMPS = 0.2  # of a signal's scale: a difference above it is too large to extrapolate from
ROUND_OFF = 1e-8  # of the largest value in the same unit
NOTHING = 1e-9  # in SI units: below it all is round-off
WHOLE = 1e-9  # of a ratio: so near to a whole number it counts as whole

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """An error of one signal, estimated from three runs; in the signal's unit.

    ``first`` is the difference of the first run to the second, ``second`` of the second to the
    third, both as largest and RMS.
    """

    local: Values  # the error, by time
    largest: float
    rms: float
    order: float  # of the RMS differences; nan where exact
    trusted: bool  # the order is one to extrapolate with; if not: difference to the finest run
    exact: bool  # the three runs differ by round-off alone
    lost_at: float | None  # s, from when on it is not predictable
    first: tuple[float, float]
    second: tuple[float, float]

    @property
    def running(self) -> Values:
        """The largest error until each time."""
        return np.maximum.accumulate(self.local)


def rms(values: Values) -> float:
    """Root of the mean square, in the values' unit."""
    return float(np.sqrt(np.mean(values**2)))


def largest(values: Values) -> float:
    """Largest absolute value, in the values' unit."""
    return float(np.max(np.abs(values)))


def observed_order(first: float, second: float) -> float:
    """Order of convergence of two successive differences; inf where the second is 0."""
    if not second:
        return float("inf")
    return log2(first / second) if first else -float("inf")


def estimate(
    time: Values, runs: Sequence[Values], scale: float, round_off: float = NOTHING
) -> Estimate:
    """The error of the first of three runs, each with half the step of the one before.

    ``scale`` is what an error is large or small against, ``round_off`` what counts as none. The
    order is that of the RMS differences, for the largest too: one instant is a poor witness.
    """
    coarse, finer, finest = runs
    first, second, both = coarse - finer, finer - finest, coarse - finest
    order = observed_order(rms(first), rms(second))
    exact = max(largest(first), largest(second)) <= round_off
    trusted = not exact and ORDERS[0] < order < ORDERS[1]
    local = np.abs(first) * 2.0**order / (2.0**order - 1.0) if trusted else np.abs(both)
    return Estimate(
        local=local,
        largest=largest(local),
        rms=rms(local),
        order=float("nan") if exact else order,
        trusted=trusted,
        exact=exact,
        lost_at=None if exact else lost_at(time, first, second, scale),
        first=(largest(first), rms(first)),
        second=(largest(second), rms(second)),
    )


def lost_at(time: Values, first: Values, second: Values, scale: float) -> float | None:
    """From when on a signal is not predictable, s; None where it is to the end.

    It is not where the second halving takes less than 20 % off the largest difference or less than
    40 % off the RMS one, and the largest exceeds 1 % of ``scale``; nor where that exceeds 20 %.
    The bounds were chosen on the scenarios, four of them over 40 s too, before jumps were
    filtered: of 124 errors above 1 %, 72 kept more than 30 % of themselves after three halvings;
    this found 69 of them, with 7 false alarms.
    """
    count = np.arange(1, len(time) + 1)
    peaks = [np.maximum.accumulate(np.abs(one)) for one in (first, second)]
    means = [np.sqrt(np.cumsum(one**2) / count) for one in (first, second)]
    lasting = (peaks[1] > SHRINK_LARGEST * peaks[0]) | (means[1] > SHRINK_RMS * means[0])
    peak = np.maximum(*peaks)
    lost = (lasting & (peak > MATTERS * scale)) | (peak > SWAMPS * scale)
    return float(time[np.argmax(lost)]) if lost[-1] else None


# --- runs ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Variant:
    """A scenario's run at one setting, which its errors name."""

    name: str
    job: Job

    @property
    def stop_time(self) -> float:
        """Simulated time, s."""
        return self.job.stop_time

    def run(self, instances: Instances, progress: Progress | None = None) -> Table:
        """Simulate in this process. Raises UserError."""
        try:
            return self.job.run(instances, progress)
        except UserError as error:
            raise UserError(f"{self.name}: {error}") from error


@dataclass(frozen=True)
class Case:
    """A run of a scenario, its signals and what is varied in it."""

    run: Run
    job: Job
    variables: Mapping[str, ScalarVariable]
    signals: tuple[str, ...]
    steps: tuple[float, ...]  # s, the scenario's own first
    elements: tuple[int, ...]

    def variants(self, scenario: str) -> list[Variant]:
        """The run itself, then with shorter steps, then with more elements."""
        own = f"{scenario}, {self.run.label}"
        variants = [Variant(own, self.job)]
        settings: list[tuple[str, float]] = [(STEP, step) for step in self.steps[1:]]
        settings += [(ELEMENTS, elements) for elements in self.elements[1:]]
        for name, value in settings:
            start = {**self.job.start_values, name: value}
            job = replace(self.job, start_values=start)
            variants.append(Variant(f"{own}, {name} = {value:g}", job))
        return variants

    @property
    def length(self) -> float:
        """Length of the chain, m, which positions are large or small against; nan: unknown."""
        if LENGTH not in self.variables:
            return float("nan")
        return setting(self.job, self.variables, LENGTH)


def prepare(scenario: Scenario, run: Run, fmus: Path, names: Sequence[str]) -> Case:
    """What is to run for ``run``; ``names``: its signals, if not the usual. Raises UserError."""
    job = scenario.job(run, shipped.fmu(fmus, run.fmu))
    variables = by_name(describe(job.fmu))
    step = internal_step(job.output_interval, setting(job, variables, STEP))
    elements = round(setting(job, variables, ELEMENTS))
    return Case(
        run=run,
        job=job,
        variables=variables,
        signals=chosen(job.fmu, variables, scenario.look_at, names),
        steps=(step, *(step / parts for parts in REFINED)),
        elements=(elements, *(elements * parts for parts in REFINED)),
    )


def by_name(description: ModelDescription) -> dict[str, ScalarVariable]:
    """An FMU's variables by name."""
    return {variable.name: variable for variable in description.modelVariables}


def setting(job: Job, variables: Mapping[str, ScalarVariable], name: str) -> float:
    """A parameter's value in a run, in its unit. Raises UserError where there is none."""
    if name not in variables:
        raise UserError(f"{job.fmu}: has no {name!r}, so its errors cannot be estimated")
    value = job.start_values.get(name, variables[name].start)
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = float("nan")
    if not (isfinite(number) and number > 0.0):
        raise UserError(f"{job.fmu}: {name} = {value!r} is not a number above 0")
    return number


def internal_step(interval: float, longest: float) -> float:
    """The FMU's internal step, s: a communication step of ``interval`` s is divided evenly."""
    return interval / max(1, ceil(interval / longest * (1.0 - WHOLE)))


def chosen(
    fmu: Path,
    variables: Mapping[str, ScalarVariable],
    look_at: Sequence[str],
    names: Sequence[str],
) -> tuple[str, ...]:
    """The signals to judge: ``names``, or those looked at and the usual ones besides."""
    outputs = real_outputs(variables)
    for name in names or look_at:
        if name not in outputs:
            raise UserError(f"{fmu}: there is no Real output {name!r}{instead(name, outputs)}")
    usual = [*look_at, *(name for name in BESIDES if name in outputs)]
    return tuple(dict.fromkeys(names or usual))


def real_outputs(variables: Mapping[str, ScalarVariable]) -> list[str]:
    """Names of the Real outputs that are no counts."""
    return [
        name
        for name, variable in variables.items()
        if (variable.causality, variable.type) == ("output", "Real")
        and variable.variability != "discrete"
    ]


# --- findings -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Signal:
    """A signal of the scenario's own run, and its two errors."""

    name: str
    unit: str | None
    values: Values
    time: Estimate
    mesh: Estimate

    @property
    def amplitude(self) -> float:
        """Largest absolute value, in the signal's unit."""
        return largest(self.values)


@dataclass(frozen=True)
class Finding:
    """What is found for one run of a scenario."""

    case: Case
    time: Values  # s
    signals: tuple[Signal, ...]

    @property
    def settings(self) -> str:
        """The run and what was varied in it."""
        steps = ", ".join(f"{1e3 * step:.4g}" for step in self.case.steps)
        elements = ", ".join(map(str, self.case.elements))
        return f"{self.case.run.label}; steps of {steps} ms; {elements} elements"


def study(
    scenario: Scenario, runs: Sequence[Run], fmus: Path, names: Sequence[str] = ()
) -> list[Finding]:
    """Estimate the errors of ``runs``, from FMU files in the folder ``fmus``. Raises UserError."""
    cases = [prepare(scenario, run, fmus, names) for run in runs]
    variants = [case.variants(scenario.name) for case in cases]
    tables = iter(simulate_all([one for some in variants for one in some], "converge"))
    return [
        found(case, some, [next(tables) for _ in some])
        for case, some in zip(cases, variants, strict=True)
    ]


def found(case: Case, variants: Sequence[Variant], tables: Sequence[Table]) -> Finding:
    """The errors of a case's signals, from the results of its variants. Raises UserError."""
    time = np.asarray(tables[0]["time"], dtype=float)
    for variant, table in zip(variants, tables, strict=True):
        if len(table) != len(time) or largest(table["time"] - time) > WHOLE:
            raise UserError(f"{variant.name}: its output points are not those of the coarser run")
        for name in case.signals:
            if not np.isfinite(table[name]).all():
                raise UserError(f"{variant.name}: {name} is not finite")
    own = tables[0]
    shorter, more = [own, *tables[1:3]], [own, *tables[3:5]]
    signals = []
    for name in case.signals:
        unit = case.variables[name].unit
        scale = case.length if unit == "m" and isfinite(case.length) else largest(own[name])
        small = max(ROUND_OFF * level(case, own, unit), NOTHING)
        errors = [
            estimate(time, [np.asarray(table[name]) for table in some], scale, small)
            for some in (shorter, more)
        ]
        signals.append(Signal(name, unit, np.asarray(own[name]), *errors))
    return Finding(case, time, tuple(signals))


def level(case: Case, own: Table, unit: str | None) -> float:
    """Largest absolute value of any Real output of a unit, which round-off goes by."""
    same = [
        name
        for name in real_outputs(case.variables)
        if case.variables[name].unit == unit and name in column_names(own)
    ]
    return max((largest(own[name]) for name in same), default=0.0)


# --- output -------------------------------------------------------------------------------------

HEADER = (
    "signal",
    "amplitude",
    "time error, largest",
    "RMS",
    "order",
    "mesh error, largest",
    "RMS",
    "order",
    "not predictable",
)
LEGEND = (
    "Errors are estimates for the scenario's own run; the order is that of the RMS differences."
    "\n*: no order to extrapolate with; the error is the difference to the finest run."
)


def number(value: float, digits: int) -> str:
    """A number with so many significant digits, without an exponent where it is not tiny."""
    if value and abs(value) < 1e-4:
        return f"{value:.{digits - 1}e}"
    text = np.format_float_positional(value, digits, unique=False, fractional=False, trim="-")
    return str(text)


def table(finding: Finding) -> str:
    """The errors of a run as Markdown, a row a signal."""
    rows = []
    for signal in finding.signals:
        factor, unit = shown(signal.unit)
        cells = [signal.name, f"{number(factor * signal.amplitude, 3)} {unit}"]
        for error in (signal.time, signal.mesh):
            if error.exact:
                cells += ["exact", "", ""]
            else:
                sizes = (error.largest, error.rms)
                cells += [f"{number(factor * size, 2)} {unit}" for size in sizes]
                cells.append(f"{error.order:.2f}{'' if error.trusted else ' *'}")
        rows.append((*cells, unpredictable(signal)))
    return markdown_table(HEADER, rows)


def unpredictable(signal: Signal) -> str:
    """Which errors of a signal cannot be predicted, and from when on; empty where all can."""
    errors = (("time", signal.time), ("mesh", signal.mesh))
    found = [(name, error.lost_at) for name, error in errors if error.lost_at is not None]
    return ", ".join(f"{name} after {lost_at:.4g} s" for name, lost_at in found)


COLUMNS: dict[str, Callable[[Estimate], float | str | bool | None]] = {
    "error_largest": lambda one: one.largest,
    "error_rms": lambda one: one.rms,
    "order_of_rms": lambda one: None if one.exact else one.order,
    "order_of_largest": lambda one: (
        None if one.exact else observed_order(one.first[0], one.second[0])
    ),
    "extrapolated": lambda one: "yes" if one.trusted else "no",
    "first_difference_largest": lambda one: one.first[0],
    "first_difference_rms": lambda one: one.first[1],
    "second_difference_largest": lambda one: one.second[0],
    "second_difference_rms": lambda one: one.second[1],
    "exact": lambda one: "yes" if one.exact else "no",
    "not_predictable_after_s": lambda one: one.lost_at,
}


def write_csv(path: Path, findings: Sequence[Finding]) -> None:
    """Write all numbers with every digit, a row for each run and signal, in the FMU's units."""
    header = ["run", "signal", "unit", "amplitude", "step_s", "elements"]
    header += [f"{error}_{column}" for error in ("time", "mesh") for column in COLUMNS]
    with whole_file(path) as partial, partial.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        for finding in findings:
            case = finding.case
            for one in finding.signals:
                row = [case.run.name, one.name, one.unit, one.amplitude]
                row += [case.steps[0], case.elements[0]]
                row += [
                    value(error) for error in (one.time, one.mesh) for value in COLUMNS.values()
                ]
                writer.writerow(row)
