"""Parameters of a crane from measured signals: least squares over runs of its FMU.

measured(t) = signal(t - time.shift) + bias.SIGNAL + noise: fitted are parameters of the FMU, and of
the sensor a bias of each signal and one shift of all times. Runs go to workers in batches:
first a scan round the start, as sway of another period has minima of its own, then a
finite-difference Jacobian at a time.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .compare import markdown_table
from .errors import UserError, instead
from .instances import describe
from .places import whole_file
from .processes import Failure, Workers, cores
from .simulate import Job
from .tables import Table

SHIFT, BIAS = "time.shift", "bias."  # names of the sensor's own parameters
SCAN = 24  # runs for each parameter in the scan
SPREAD = 3.0  # factor: the scan goes from a third of a start value to three times it
BEST = 5  # points of a scan that are refined
FEW = 8  # steps of refining at first
ROUNDS = 4  # scans at most
AROUND = 30.0  # standard errors: so far round a minimum another one is looked for
STEP = 1e-3  # of a parameter: its finite difference, to both sides
ALIKE = 0.99  # correlation from which on two parameters cannot be told apart
VAGUE = 0.5  # of a value: a standard error above it says that the data do not tell it
COLOURED = 0.2  # correlation of a residual with the next one, from which on errors are too small

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Measured:
    """Measured signals: ``times`` in s, ``signals`` by name, not a number where one is missing."""

    times: Values
    signals: Mapping[str, Values]

    def vector(self) -> Values:
        """All values, signal after signal."""
        return np.concatenate(list(self.signals.values()))


@dataclass(frozen=True)
class Parameter:
    """What is fitted: ``scale`` is its size, ``least`` and ``most`` its bounds, in its unit."""

    name: str
    unit: str
    guess: float
    scale: float
    least: float = -np.inf
    most: float = np.inf

    @property
    def of_the_fmu(self) -> bool:
        """Is it a start value of the FMU, not the sensor's?"""
        return self.name != SHIFT and not self.name.startswith(BIAS)


@dataclass(frozen=True)
class Fit:
    """The best fit: values, standard errors and correlation of the parameters, in their order."""

    parameters: tuple[Parameter, ...]
    values: Values
    errors: Values
    correlation: Values
    times: Values  # s
    measured: Mapping[str, Values]
    fitted: Mapping[str, Values]
    runs: int

    @property
    def residual(self) -> Values:
        """Measured minus fitted, signal after signal, without what is missing."""
        gaps = [self.measured[name] - self.fitted[name] for name in self.measured]
        found = np.concatenate(gaps)
        return found[np.isfinite(found)]

    @property
    def noise(self) -> float:
        """Standard deviation of the residual."""
        found = self.residual
        return float(np.sqrt(np.sum(found**2) / (len(found) - len(self.parameters))))

    def warnings(self) -> list[str]:
        """What the data cannot tell, and what the standard errors do not know."""
        found = []
        names = [one.name for one in self.parameters]
        for place, one in enumerate(self.parameters):
            size = max(abs(self.values[place]), one.scale if not one.of_the_fmu else 0.0)
            if one.of_the_fmu and not self.errors[place] < VAGUE * size:
                error = self.errors[place]
                found.append(f"the data hardly tell {one.name}: its standard error is {error:.2g}")
            if self.values[place] <= one.least or self.values[place] >= one.most:
                found.append(f"{one.name} is at its bound: its standard error means nothing")
            for other in range(place):
                r = self.correlation[place, other]
                if abs(r) > ALIKE:
                    found.append(
                        f"the data cannot tell {names[other]} and {one.name} apart: correlation"
                        f" {r:.4f}; fix one of them"
                    )
        for name in self.measured:
            gap = self.measured[name] - self.fitted[name]
            gap = gap[np.isfinite(gap)]
            r = next_to_next(gap)
            if r > COLOURED:
                found.append(
                    f"the residual of {name} is no white noise (correlation {r:.2f} from one to the"
                    " next): model or inputs are not the crane's, and errors are larger than told"
                )
        return found


def read_measured(path: Path) -> Measured:
    """A CSV file of time and signals; an empty cell, or nan, is a value that is missing.

    Raises UserError.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [row for row in csv.reader(file) if row]
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not a text file"
        raise UserError(f"{path}: cannot be read: {reason}") from error
    header = [name.strip() for name in rows[0]] if rows else []
    if len(header) < 2 or header[0] != "time" or len(set(header)) < len(header):
        raise UserError(f"{path}: the header needs 'time' first, then signals, and no name twice")
    table = np.full((len(rows) - 1, len(header)), np.nan)
    for place, row in enumerate(rows[1:]):
        if len(row) != len(header):
            raise UserError(f"{path}, row {place + 2}: {len(row)} values for {len(header)} columns")
        for column, text in enumerate(row):
            try:
                table[place, column] = float(text.strip() or "nan")
            except ValueError:
                where = f"{path}, row {place + 2}, {header[column]}"
                raise UserError(f"{where}: {text!r} is not a number") from None
    times = table[:, 0]
    if not np.isfinite(times).all() or np.any(np.diff(times) < 0.0) or np.isinf(table).any():
        raise UserError(f"{path}: times must be finite and not go backwards, values be finite")
    signals = {name: table[:, column] for column, name in enumerate(header) if column}
    return Measured(times, signals)


def parameters(
    job: Job, measured: Measured, asked: Sequence[str], shift: bool, bias: bool
) -> tuple[Parameter, ...]:
    """What to fit: ``asked`` are NAME or NAME=START. Raises UserError."""
    variables = {v.name: v for v in describe(job.fmu).modelVariables}
    outputs = [name for name, v in variables.items() if v.causality == "output"]
    for name in measured.signals:
        if name not in outputs:
            raise UserError(f"{job.fmu}: there is no output {name!r}{instead(name, outputs)}")
    found = []
    for text in asked:
        name, equals, start = text.partition("=")
        known = [n for n, v in variables.items() if (v.causality, v.type) == ("parameter", "Real")]
        if name not in known:
            raise UserError(f"--fit {text!r}: no Real parameter is {name!r}{instead(name, known)}")
        variable = variables[name]
        guess = _number(f"--fit {text!r}", start if equals else None, job, name, variable.start)
        least, most = (
            -np.inf if variable.min is None else float(variable.min),
            np.inf if variable.max is None else float(variable.max),
        )
        if not least <= guess <= most:
            smallest = 0.0 < least < 1e-300  # the XML's way to say: above 0
            allowed = "above 0" if smallest else f"{least:g} or more"
            allowed += "" if np.isinf(most) else f", {most:g} at most"
            raise UserError(f"--fit {text!r} is not allowed: {allowed}")
        scale = abs(guess) or ZERO_SCALE
        found.append(Parameter(name, variable.unit or "", guess, scale, least, most))
    if len({one.name for one in found}) < len(found):
        raise UserError("--fit names a parameter twice")
    if shift:
        found.append(Parameter(SHIFT, "s", 0.0, 0.01))
    for name, values in measured.signals.items() if bias else ():
        found.append(Parameter(f"{BIAS}{name}", variables[name].unit or "", 0.0, _spread(values)))
    if not found:
        raise UserError("nothing to fit: give --fit NAME, --shift or --bias")
    if np.isfinite(measured.vector()).sum() <= len(found):
        raise UserError(f"too few measured values for {len(found)} parameters")
    return tuple(found)


ZERO_SCALE = 0.01  # the size of a parameter that starts from 0, in its unit


def _number(where: str, text: str | None, job: Job, name: str, start: Any) -> float:
    value = job.start_values.get(name, start) if text is None else text
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = float("nan")
    if not isfinite(number):
        raise UserError(f"{where}: {value!r} is not a finite number")
    return number


def _spread(values: Values) -> float:
    return float(np.nanstd(values)) or 1.0


class Problem:
    """The least-squares problem, in parameters over their scales."""

    def __init__(
        self, job: Job, measured: Measured, asked: Sequence[Parameter], workers: Workers
    ) -> None:
        self.measured, self.asked, self._workers = measured, tuple(asked), workers
        self._job = replace(job, outputs=tuple(measured.signals))
        self._there = np.isfinite(measured.vector())
        self.scales = np.array([one.scale for one in asked])
        self.runs = 0
        self.refusal = ""  # why the last one that was refused was

    def values(self, x: Values) -> dict[str, float]:
        """The parameters' values by name."""
        scaled = zip(self.asked, x * self.scales, strict=True)
        return {one.name: float(min(max(v, one.least), one.most)) for one, v in scaled}

    def simulate(self, points: Sequence[Values]) -> list[Table | None]:
        """A run at each point, in one batch; None where the FMU refuses."""
        work = []
        for x in points:
            values = self.values(x)
            of_fmu = {one.name: values[one.name] for one in self.asked if one.of_the_fmu}
            work.append(replace(self._job, start_values={**self._job.start_values, **of_fmu}))
        self.runs += len(work)
        found: list[Table | None] = [None] * len(work)
        for number, result in self._workers.run(enumerate(work)):
            if isinstance(result, Failure):
                self.refusal = str(result)
            else:
                found[number] = result
        return found

    def predicted(self, x: Values, table: Table) -> dict[str, Values]:
        """The signals as the sensor would give them, by name, at the measured times."""
        from scipy.interpolate import CubicSpline

        values = self.values(x)
        time, once = np.unique(table["time"], return_index=True)
        at = np.clip(self.measured.times - values.get(SHIFT, 0.0), time[0], time[-1])
        return {
            name: CubicSpline(time, table[name][once])(at) + values.get(f"{BIAS}{name}", 0.0)
            for name in self.measured.signals
        }

    def residual(self, x: Values, table: Table | None) -> Values:
        """Predicted minus measured, over each signal's spread, where it was measured."""
        if table is None:  # a value that the FMU refuses: far off, so that no step goes there
            return np.full(int(self._there.sum()), 1e3)
        gaps = [
            (predicted - self.measured.signals[name]) / _spread(self.measured.signals[name])
            for name, predicted in self.predicted(x, table).items()
        ]
        return np.asarray(np.concatenate(gaps)[self._there])

    def fun(self, x: Values) -> Values:
        """The residual at a point, by a run."""
        return self.residual(x, self.simulate([x])[0])

    def jacobian(self, x: Values) -> Values:
        """Its derivatives by central differences, all runs in one batch."""
        points, steps = [], []
        for place, one in enumerate(self.asked):
            for sign in (-1.0, 1.0):
                moved = x.copy()
                step = STEP * max(abs(x[place]), 0.1)
                moved[place] = np.clip(
                    x[place] + sign * step, one.least / one.scale, one.most / one.scale
                )
                points.append(moved)
            steps.append(points[-1][place] - points[-2][place])
        tables = self.simulate(points)
        columns = []
        for place, step in enumerate(steps):
            ends = [self.residual(points[n], tables[n]) for n in (2 * place, 2 * place + 1)]
            columns.append((ends[1] - ends[0]) / step)
        return np.array(columns).T


def fit(job: Job, measured: Measured, asked: Sequence[Parameter], seed: int = 0) -> Fit:
    """Fit parameters to what was measured in a run like ``job``. Raises UserError."""
    if measured.times[0] < 0.0 or measured.times[-1] > job.stop_time + 1e-9:
        raise UserError(f"measured times must be within the scenario's 0 to {job.stop_time:g} s")
    with Workers(cores()) as workers:
        problem = Problem(job, measured, asked, workers)
        best = _best(problem, seed)
        x = np.asarray(best.x)
        (table,) = problem.simulate([x])
        if table is None:
            raise UserError(f"no value that was tried would do: {problem.refusal}")
        jacobian = problem.jacobian(x)
        fitted = problem.predicted(x, table)
        runs = problem.runs
    covariance = _covariance(jacobian, float(best.cost))
    errors = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = covariance / np.outer(errors, errors)
    values = np.array(list(problem.values(x).values()))
    return Fit(
        tuple(asked),
        values,
        errors * problem.scales,
        correlation,
        measured.times,
        measured.signals,
        fitted,
        runs,
    )


def _best(problem: Problem, seed: int) -> Any:
    """The best minimum, as scipy's least_squares gives it.

    Waves of the chain make minima of their own. While the residual of the best is no white noise,
    others are looked for: first far round the start, then round the best, many standard errors far.
    """
    random = np.random.default_rng(seed)
    start = np.array([one.guess for one in problem.asked]) / problem.scales
    best = _refined(problem, start, None)
    spread = np.full(len(start), np.log(SPREAD))
    around, each = start, SCAN
    for _ in range(ROUNDS):
        if next_to_next(best.fun) < COLOURED:
            break
        points = _scan(problem, around, spread, each, random)
        found = [_refined(problem, x, FEW) for x in _fitting(problem, points, BEST)]
        best = min([best, *found], key=lambda one: float(one.cost))
        best = _refined(problem, best.x, None)
        around, each = np.asarray(best.x), 2 * SCAN
        size = np.maximum(np.abs(best.x), 1e-9)
        spread = np.minimum(AROUND * deviations(best.jac, best.cost) / size, np.log(SPREAD))
    return best


def _refined(problem: Problem, x: Values, most: int | None) -> Any:
    """A local minimum, after ``most`` steps if there are more."""
    from scipy.optimize import least_squares

    lows = np.array([one.least for one in problem.asked]) / problem.scales
    highs = np.array([one.most for one in problem.asked]) / problem.scales
    exact = 1e-10 if most is None else 1e-5
    return least_squares(
        problem.fun,
        np.clip(x, lows, highs),
        problem.jacobian,
        (lows, highs),
        x_scale="jac",
        xtol=exact,
        ftol=exact,
        max_nfev=most,
    )


def deviations(jacobian: Values, cost: float) -> Values:
    """Standard errors, from the Jacobian and half the sum of squares of the residual."""
    return np.asarray(np.sqrt(np.diag(_covariance(jacobian, cost))))


def _covariance(jacobian: Values, cost: float) -> Values:
    variance = 2.0 * cost / (len(jacobian) - jacobian.shape[1])
    return np.asarray(variance * np.linalg.pinv(jacobian.T @ jacobian, hermitian=True))


def next_to_next(gap: Values) -> float:
    """Correlation of a residual's values with the ones after them."""
    return float(np.dot(gap[1:], gap[:-1]) / np.dot(gap, gap)) if gap.any() else 0.0


def _scan(
    problem: Problem, x: Values, spread: Values, each: int, random: np.random.Generator
) -> list[Values]:
    """Points of a Latin hypercube of the FMU's parameters round x; ``spread`` of their logarithms.

    A parameter that is 0 stays there.
    """
    from scipy.stats import qmc

    moving = [n for n, one in enumerate(problem.asked) if one.of_the_fmu and x[n] and spread[n]]
    if not moving:
        return []
    lows = np.array([one.least for one in problem.asked]) / problem.scales
    highs = np.array([one.most for one in problem.asked]) / problem.scales
    points = []
    for row in qmc.LatinHypercube(len(moving), seed=random).random(each * len(moving)):
        point = x.copy()
        point[moving] *= np.exp((2.0 * row - 1.0) * spread[moving])
        points.append(np.clip(point, lows, highs))
    return points


def _fitting(problem: Problem, points: Sequence[Values], count: int) -> list[Values]:
    """The points that fit best."""
    costs = [
        float(np.sum(problem.residual(x, table) ** 2))
        for x, table in zip(points, problem.simulate(points), strict=True)
    ]
    return [points[place] for place in np.argsort(costs)[:count]]


def report(found: Fit) -> str:
    """The parameters as a table, their correlations, and what the data cannot tell."""
    rows = [
        (one.name, f"{value:.6g} {one.unit}".strip(), f"{error:.2g} {one.unit}".strip())
        for one, value, error in zip(found.parameters, found.values, found.errors, strict=True)
    ]
    text = markdown_table(("parameter", "value", "standard error"), rows)
    names = [one.name for one in found.parameters]
    if len(names) > 1:
        table = []
        for row, name in enumerate(names):
            cells = [f"{found.correlation[row, column]:.3f}" for column in range(row + 1)]
            table.append((name, *cells, *[""] * (len(names) - len(cells))))
        text += "\n\n" + markdown_table(("correlation", *names), table)
    text += f"\n\nresidual {found.noise:.3g} RMS, {len(found.residual)} values, {found.runs} runs"
    for warning in found.warnings():
        text += f"\nnote: {warning}"
    return text


def write_csv(path: Path, found: Fit) -> None:
    """Values and standard errors with every digit. Raises OSError."""
    with whole_file(path) as partial, partial.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["parameter", "unit", "value", "standard_error"])
        for one, value, error in zip(found.parameters, found.values, found.errors, strict=True):
            writer.writerow([one.name, one.unit, repr(float(value)), repr(float(error))])


def picture(found: Fit, units: Mapping[str, str | None], title: str, stem: Path) -> list[Path]:
    """What was measured and the fit, and below the residual, for each signal."""
    from .plots import new_figure, save_figure

    signals = list(found.measured)
    count = len(signals)
    figure, axes = new_figure(
        2 * count, 1, 7.0, 4.2 * count, sharex=True, height_ratios=(2, 1) * count
    )
    for place, name in enumerate(signals):
        above, below = axes[2 * place, 0], axes[2 * place + 1, 0]
        dots = {"color": "0.6", "markersize": 3, "label": "measured"}
        above.plot(found.times, found.measured[name], ".", **dots)
        above.plot(found.times, found.fitted[name], color="#0072B2", linewidth=1.2, label="fit")
        above.set_ylabel(f"{name} [{units.get(name) or ''}]")
        gap = found.measured[name] - found.fitted[name]
        below.plot(found.times, gap, ".", color="#D55E00", markersize=2)
        below.axhline(0.0, color="black", linewidth=0.6)
        below.set_ylabel("residual")
    axes[0, 0].legend(fontsize=8)
    axes[0, 0].set_title(title)
    axes[-1, 0].set_xlabel("time [s]")
    return save_figure(figure, stem)
