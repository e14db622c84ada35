"""Scenarios: folders of data that say which FMUs to run, how, and what must come out."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .errors import UserError
from .simulate import Job
from .tables import read_table

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


@dataclass(frozen=True)
class Run:
    """One FMU with its start values."""

    name: str
    label: str
    fmu: str
    start: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Scenario:
    """A question about the cranes, as data."""

    folder: Path
    title: str
    asks: str
    stop_time: float  # s
    output_interval: float  # s
    reference_interval: float  # s, of the rows that are kept as reference
    look_at: tuple[str, ...]
    start: dict[str, Any]
    runs: tuple[Run, ...]
    tolerance: dict[str, dict[str, Any]]
    input: Path | None

    @property
    def name(self) -> str:
        """The folder's name."""
        return self.folder.name

    def reference(self, run: Run) -> Path:
        """Where the frozen result of ``run`` is kept."""
        return self.folder / f"reference_{run.name}.csv"

    def job(self, run: Run, fmu: Path) -> Job:
        """The simulation that ``run`` asks for, with the FMU file ``fmu``."""
        return Job(
            fmu,
            self.start | run.start,
            None if self.input is None else read_table(self.input),
            self.stop_time,
            self.output_interval,
        )


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file as a dictionary. Raises UserError."""
    try:
        with path.open("rb") as file:
            return tomllib.load(file)
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: not valid TOML: {error}") from error


def load(folder: Path) -> Scenario:
    """Load the scenario of a folder. Raises UserError, naming the key that is missing or wrong."""
    path = folder / "scenario.toml"
    data = read_toml(path)
    try:
        experiment = data["experiment"]
        stop_time = float(experiment["stop_time"])
        interval = float(experiment["output_interval"])
        runs = tuple(
            Run(
                _text(run, "name"),
                _text(run, "label"),
                _text(run, "fmu"),
                dict(run.get("start", {})),
            )
            for run in data["run"]
        )
        scenario = Scenario(
            folder=folder.resolve(),
            title=_text(data, "title"),
            asks=_text(data, "asks"),
            stop_time=stop_time,
            output_interval=interval,
            reference_interval=float(experiment.get("reference_interval", interval)),
            look_at=_texts(experiment, "look_at"),
            start=dict(data.get("start", {})),
            runs=runs,
            tolerance=dict(data.get("tolerance", {})),
            input=folder / _text(experiment, "input") if "input" in experiment else None,
        )
    except KeyError as error:
        raise UserError(f"{path}: the key {error.args[0]!r} is missing") from error
    except (TypeError, ValueError, AttributeError) as error:
        raise UserError(f"{path}: {error}") from error
    if not 0.0 < interval <= stop_time < float("inf"):
        raise UserError(f"{path}: needs 0 < output_interval <= stop_time, both in seconds")
    if not runs or len({run.name for run in runs}) < len(runs):
        raise UserError(f"{path}: needs at least one [[run]], and no name twice")
    rows = scenario.reference_interval / interval
    if not (rows > 0.5 and abs(rows - round(rows)) < 1e-9):
        raise UserError(f"{path}: reference_interval must be a multiple of output_interval")
    return scenario


def _text(table: dict[str, Any], key: str) -> str:
    if not isinstance(table[key], str):
        raise TypeError(f"{key} = {table[key]!r} must be a text in quotes")
    return str(table[key])


def _texts(table: dict[str, Any], key: str) -> tuple[str, ...]:
    value = table[key]
    if not isinstance(value, list) or not value or not all(isinstance(v, str) for v in value):
        raise TypeError(f"{key} = {value!r} must be a list of names in quotes")
    return tuple(value)


def find(folder: Path) -> list[Scenario]:
    """All scenarios below a folder, by name."""
    found = sorted(path.parent for path in folder.glob("*/scenario.toml"))
    if not found:
        raise UserError(f"{folder}: no scenarios here (folders with a scenario.toml)")
    return [load(path) for path in found]
