"""What a sweep runs in each of its cases, and what it keeps of it: a scenario, or the closed loop.

A subject travels to the workers once and its FMUs with it; a case is no more than some values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from fmpy.model_description import ModelDescription
from numpy.typing import NDArray

from . import shipped
from .antisway import Metrics, Setup, measure
from .errors import UserError, instead
from .instances import Instances, describe
from .loop import CRANE, SEPARATOR
from .scenario import Run, Scenario
from .simulate import Job, grid_of
from .start_values import check_start_values
from .tables import Table
from .vary import Case, Design

MOST_DRAWN = 4  # metrics in a picture
# What is measured of a signal, in its own unit, and what against the first run of a comparison.
MEASURES = {
    "peak": "largest absolute value",
    "rms": "root of the mean square",
    "last": "value at the end",
}
DIFFERENCES = {
    "difference_rms": "RMS difference to the first run",
    "difference_largest": "largest difference to the first run",
}


@dataclass(frozen=True)
class Metric:
    """A number that is kept of each run."""

    name: str
    unit: str
    meaning: str


@dataclass(frozen=True)
class Outcome:
    """What is kept of a case: ``metrics`` by run and metric, ``series`` by run, signal and time.

    Of a run that failed they are not a number, and ``messages`` has its reason; else that is "".
    """

    metrics: NDArray[np.float64]
    series: NDArray[np.float64]
    messages: tuple[str, ...]


class Subject(Protocol):
    """What is run in each case."""

    @property
    def fmus(self) -> Mapping[str, Path]:
        """FMU files by name."""

    @property
    def runs(self) -> tuple[str, ...]:
        """Labels of a case's runs."""

    @property
    def metrics(self) -> tuple[Metric, ...]:
        """What is measured of each run."""

    @property
    def drawn(self) -> tuple[str, ...]:
        """Names of the metrics that are drawn if nobody says which."""

    @property
    def kept(self) -> tuple[str, ...]:
        """Signals whose time series are kept."""

    @property
    def units(self) -> Mapping[str, str]:
        """Of the signals that are kept, and of what varies."""

    def check(self, design: Design) -> None:
        """Raises UserError for a name that cannot be varied, or a value of another type."""

    def times(self) -> NDArray[np.float64]:
        """Times of the series, s."""

    def run(self, case: Case, instances: Instances) -> Outcome:
        """Run a case. What fails is in the outcome."""

    def with_fmus(self, fmus: Mapping[str, Path]) -> Subject:
        """The same with other files for its FMUs, by their names."""

    def fingerprint(self) -> dict[str, str]:
        """What results depend on, FMUs apart: hashes by what they are of."""


def digest(*parts: Any) -> str:
    """A short hash of values; of an array its bytes."""
    found = sha256()
    for part in parts:
        found.update(part.tobytes() if isinstance(part, np.ndarray) else repr(part).encode())
        found.update(b"\0")
    return found.hexdigest()[:16]


def failed(subject: Subject, messages: Sequence[str]) -> Outcome:
    """The outcome of a case that gave nothing."""
    runs = len(subject.runs)
    metrics = np.full((runs, len(subject.metrics)), np.nan)
    return Outcome(metrics, _no_series(subject), tuple(messages))


def _no_series(subject: Subject) -> NDArray[np.float64]:
    times = len(subject.times()) if subject.kept else 0
    return np.full((len(subject.runs), len(subject.kept), times), np.nan)


# --- a scenario: one FMU, or a comparison -------------------------------------------------------


@dataclass(frozen=True)
class ScenarioSubject:
    """Runs of a scenario, all with a case's values; the first is what others are compared with."""

    jobs: tuple[Job, ...]
    runs: tuple[str, ...]
    signals: tuple[str, ...]  # that are measured
    kept: tuple[str, ...]
    units: Mapping[str, str]
    fmus: Mapping[str, Path]
    points: NDArray[np.float64]  # communication points, s

    @property
    def metrics(self) -> tuple[Metric, ...]:
        """Each measure of each signal."""
        measures = MEASURES | (DIFFERENCES if len(self.runs) > 1 else {})
        return tuple(
            Metric(f"{signal}.{name}", self.units[signal], f"{meaning} of {signal}")
            for signal in self.signals
            for name, meaning in measures.items()
        )

    @property
    def drawn(self) -> tuple[str, ...]:
        """What tells most of each signal that the scenario looks at."""
        compared = [f"{signal}.difference_largest" for signal in self.signals]
        peaks = [f"{signal}.peak" for signal in self.signals]
        return tuple(compared if len(self.runs) > 1 else peaks)[:MOST_DRAWN]

    def check(self, design: Design) -> None:
        """Every run's FMU must have what varies, and what it starts with. Raises UserError."""
        for job in self.jobs:
            description = describe(job.fmu)
            check_start_values(job.fmu, description, job.start_values)
            _check(design, job.fmu, description, "")

    def times(self) -> NDArray[np.float64]:
        """Times of the series, s."""
        return self.points

    def run(self, case: Case, instances: Instances) -> Outcome:
        """Run the scenario's runs with a case's values."""
        tables: list[Table | None] = []
        messages = []
        for job in self.jobs:
            try:
                start = {**job.start_values, **case}
                tables.append(replace(job, start_values=start).run(instances))
                messages.append("")
            except UserError as error:
                tables.append(None)
                messages.append(str(error).removeprefix(f"{job.fmu}: "))
        series = _no_series(self)
        for run, table in enumerate(tables):
            if table is not None:
                for place, name in enumerate(self.kept):
                    series[run, place] = table[name]
        metrics = [self._measure(table, tables[0]) for table in tables]
        return Outcome(np.array(metrics), series, tuple(messages))

    def _measure(self, table: Table | None, first: Table | None) -> list[float]:
        """The metrics of a run; ``first``: the run that it is compared with."""
        found: list[float] = []
        for signal in self.signals:
            if table is None:
                found += [np.nan] * len(MEASURES)
            else:
                values = table[signal]
                found += [np.abs(values).max(), np.sqrt(np.mean(values**2)), values[-1]]
            if len(self.runs) == 1:
                continue
            if table is None or first is None or table is first:
                found += [np.nan] * len(DIFFERENCES)
            else:
                gap = table[signal] - first[signal]
                found += [np.sqrt(np.mean(gap**2)), np.abs(gap).max()]
        return found

    def with_fmus(self, fmus: Mapping[str, Path]) -> ScenarioSubject:
        """The same with other files for its FMUs, by their names."""
        jobs = tuple(replace(job, fmu=fmus[job.fmu.name]) for job in self.jobs)
        return replace(self, jobs=jobs, fmus=fmus)

    def fingerprint(self) -> dict[str, str]:
        """Of the scenario: start values, inputs, times; of what is kept."""
        scenario = [
            (
                job.fmu.name,
                sorted(job.start_values.items()),
                None if job.inputs is None else (job.inputs.dtype.names, job.inputs.tobytes()),
                job.stop_time,
                job.output_interval,
            )
            for job in self.jobs
        ]
        return {
            "scenario": digest(scenario, self.runs),
            "metrics and series": digest(self.signals, self.kept),
        }


def scenario_subject(
    one: Scenario,
    runs: Sequence[Run],
    fmus: Path,
    signals: Sequence[str] = (),
    kept: Sequence[str] = (),
    fmu: Path | None = None,
) -> ScenarioSubject:
    """Some runs of a scenario, with FMUs of a folder, or all with the file ``fmu``.

    ``signals``: what is measured beside what the scenario looks at; ``kept``: whose series are
    kept. Raises UserError for what is no Real output.
    """
    measured = tuple(dict.fromkeys((*one.look_at, *signals)))
    outputs = tuple(dict.fromkeys((*measured, *kept)))
    every = [one.job(run, fmu or shipped.fmu(fmus, run.fmu)) for run in runs]
    jobs = tuple(replace(job, outputs=outputs) for job in every)
    units: dict[str, str] = {}
    for job in jobs:
        variables = {v.name: v for v in describe(job.fmu).modelVariables}
        for name in outputs:
            variable = variables.get(name)
            if variable is None or (variable.type, variable.causality) != ("Real", "output"):
                near = instead(name, (n for n, v in variables.items() if v.causality == "output"))
                raise UserError(f"{job.fmu}: there is no Real output {name!r}{near}")
        units |= {name: variable.unit or "" for name, variable in variables.items()}
    files = {job.fmu.name: job.fmu for job in jobs}
    if len({job.fmu for job in jobs}) > len(files):
        raise UserError("two FMUs of a sweep have one file name")
    labels = tuple(run.label for run in runs)
    points = grid_of(jobs[0], describe(jobs[0].fmu)).times
    return ScenarioSubject(jobs, labels, measured, tuple(kept), units, files, points)


# --- the closed loop ----------------------------------------------------------------------------

# What can be varied of the loop beside its parts' start values: fields of Setup, by the words of
# chaincrane antisway.
WORDS = {
    "payload": "payload",
    "elements": "observer",
    "sensor": "sensor",
    "method": "method",
    "plant": "plant",
    "target": "target",
    "believed": "believed",
    "step": "step",
    "stop": "stop_time",
    "order": "order",
}
LENGTHS = ("step", "stop")  # words that change the times of the series
UNITS_OF_METRICS = {"settling": "s", "effort": "m/s2"}  # the others are lengths


@dataclass(frozen=True)
class LoopSubject:
    """The closed loop of crane, observer and controller."""

    setup: Setup
    folder: Path
    kept: tuple[str, ...]
    units: Mapping[str, str]
    fmus: Mapping[str, Path]
    runs: tuple[str, ...] = ("closed loop",)

    @property
    def metrics(self) -> tuple[Metric, ...]:
        """What chaincrane antisway measures."""
        return tuple(
            Metric(field.name, UNITS_OF_METRICS.get(field.name, "m"), title)
            for field, title in zip(fields(Metrics), Metrics.HEADER, strict=True)
        )

    @property
    def drawn(self) -> tuple[str, ...]:
        """How far off the estimate is, and what sway is left."""
        return "payload_rms", "residual"

    def check(self, design: Design) -> None:
        """Raises UserError for a word that the loop has not, or a start value that is none."""
        fmus = self.setup.loop(self.folder).fmus
        for name in design.names:
            part, separator, _ = name.partition(SEPARATOR)
            if name in LENGTHS and self.kept:
                raise UserError(f"--keep needs the same times in every case, and {name} varies")
            if separator and part in fmus:
                _check(design, fmus[part], describe(fmus[part]), f"{part}{SEPARATOR}")
            elif name not in WORDS:
                known = ", ".join((*WORDS, f"{CRANE}{SEPARATOR}payload.fx"))
                raise UserError(f"{name!r} cannot be varied in the closed loop: {known}, say")
            else:
                for value in design.values(name):
                    self._setup({name: value})

    def _setup(self, case: Case) -> Setup:
        """The run of a case. Raises UserError for a value of another type than its field's."""
        setup, more = self.setup, {part: dict(own) for part, own in self.setup.more.items()}
        for name, value in case.items():
            if SEPARATOR in name:
                part, _, variable = name.partition(SEPARATOR)
                more.setdefault(part, {})[variable] = value
                continue
            now = getattr(setup, WORDS[name])
            kind: Any = int if now is None else type(now)  # no number of elements: string modes
            if kind in (int, float) and not isinstance(value, (int, float)):
                raise UserError(f"{name} = {value!r} is not allowed: a number")
            if kind is int and not float(value).is_integer():
                raise UserError(f"{name} = {value!r} is not allowed: a whole number")
            setup = replace(setup, **{WORDS[name]: kind(value)})
        return replace(setup, more=more)

    def times(self) -> NDArray[np.float64]:
        """Times of the series, s."""
        loop = self.setup.loop(self.folder)
        return np.array([number * loop.step for number in range(loop.steps + 1)])

    def run(self, case: Case, instances: Instances) -> Outcome:
        """Run the loop with a case's values."""
        try:
            setup = self._setup(case)
            table = setup.loop(self.folder).run(instances)
        except UserError as error:
            return failed(self, [str(error)])
        found = measure(table, setup.target)
        metrics = [float(getattr(found, one.name)) for one in self.metrics]
        series = np.array([[table[name] for name in self.kept]]) if self.kept else _no_series(self)
        return Outcome(np.array([metrics]), series, ("",))

    def with_fmus(self, fmus: Mapping[str, Path]) -> LoopSubject:
        """The same with its FMUs' files in another folder, under the same names."""
        (folder,) = {path.parent for path in fmus.values()}
        return replace(self, folder=folder, fmus=fmus)

    def fingerprint(self) -> dict[str, str]:
        """Of the loop's setting, and of what is kept."""
        names = [metric.name for metric in self.metrics]
        return {
            "closed loop": digest(self.setup),
            "metrics and series": digest(names, self.kept),
        }


def loop_subject(setup: Setup, fmus: Path, design: Design, kept: Sequence[str] = ()) -> LoopSubject:
    """The closed loop with FMUs of a folder; every plant that ``design`` names is among them."""
    loop = setup.loop(fmus)
    files = dict.fromkeys(loop.fmus.values())
    if "plant" in design.names:
        files |= dict.fromkeys(shipped.fmu(fmus, f"{one}.fmu") for one in design.values("plant"))
    known = {name for name in loop.table().dtype.names or () if name != "time"}
    for name in kept:
        if name not in known:
            raise UserError(f"there is no signal {name!r} in the loop: {', '.join(sorted(known))}")
    units = {word: "" for word in WORDS} | {"payload": "kg", "target": "m", "step": "s"}
    units["stop"] = "s"
    for part, fmu in loop.fmus.items():
        for v in describe(fmu).modelVariables:
            units[f"{part}{SEPARATOR}{v.name}"] = v.unit or ""
    return LoopSubject(setup, fmus, tuple(kept), units, {file.name: file for file in files})


def _check(design: Design, fmu: Path, description: ModelDescription, prefix: str) -> None:
    """Raises UserError for a name of ``design`` that cannot be set, or a value of no right type."""
    for name in design.names:
        if name.startswith(prefix):
            for value in design.values(name):
                check_start_values(fmu, description, {name.removeprefix(prefix): value})
