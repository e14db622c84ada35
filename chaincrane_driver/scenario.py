"""Scenarios: folders of data that say which FMUs to run, how, and what must come out."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import Any

from . import shipped
from .errors import UserError, instead
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

    def named(self, names: Sequence[str]) -> tuple[Run, ...]:
        """The runs of these names, or all where none is asked for. Raises UserError."""
        known = [run.name for run in self.runs]
        for name in names:
            if name not in known:
                raise UserError(f"{self.folder}: there is no run {name!r}{instead(name, known)}")
        return tuple(run for run in self.runs if not names or run.name in names)

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


# The keys that a scenario has, by table, and what each is. Those in brackets may be left out.
KEYS: dict[str, dict[str, str]] = {
    "": {
        "title": "text",
        "asks": "(text)",
        "experiment": "table",
        "start": "(table)",
        "run": "tables",
        "tolerance": "(table)",
    },
    "experiment": {
        "stop_time": "number",
        "output_interval": "number",
        "reference_interval": "(number)",
        "input": "(text)",
        "look_at": "(texts)",
    },
    "run": {"name": "text", "label": "(text)", "fmu": "text", "start": "(table)"},
    "tolerance": {"absolute": "number", "reason": "text"},
}
ASKED = {
    "text": "a text in quotes",
    "texts": "a list of names in quotes",
    "number": "a finite number",
    "table": "a table of names and values",
    "tables": "tables, each headed by [[run]]",
}
FILE_NAME = r"[\w.-]+"
LOOK_AT = ("payload.x_rel",)  # where a scenario does not say


def checked(path: Path, where: str, table: Any, keys: Mapping[str, str]) -> dict[str, Any]:
    """A table of a TOML file whose keys are known, complete and of the right type, or UserError."""
    place = f"{path}: {where + ': ' if where else ''}"
    if not isinstance(table, dict):
        raise UserError(f"{place}{table!r} is not {ASKED['table']}")
    for key in table:
        if key not in keys:
            raise UserError(f"{place}there is no key {key!r}{instead(key, keys)}")
    for key, kind in keys.items():
        if key in table:
            kind = kind.strip("()")
            if not _is(kind, table[key]):
                raise UserError(f"{place}{key} = {table[key]!r} is not {ASKED[kind]}")
        elif not kind.startswith("("):
            raise UserError(f"{place}the key {key!r} is missing")
    return table


def _is(kind: str, value: Any) -> bool:
    if kind == "text":
        return isinstance(value, str)
    if kind == "number":
        return type(value) in (int, float) and isfinite(value)
    if kind == "table":
        return isinstance(value, dict)
    of = str if kind == "texts" else dict
    return isinstance(value, list) and bool(value) and all(isinstance(one, of) for one in value)


def checked_rules(path: Path, rules: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Tolerances by pattern, each checked. Raises UserError."""
    for pattern, rule in rules.items():
        if checked(path, repr(pattern), rule, KEYS["tolerance"])["absolute"] < 0:
            raise UserError(f"{path}: {pattern!r}: absolute = {rule['absolute']!r} is below 0")
    return rules


def load(folder: Path) -> Scenario:
    """Load the scenario of a folder, or the one of ours that has its name.

    Raises UserError, naming the key that is missing or wrong.
    """
    folder = shipped.scenario(folder)
    path = folder / "scenario.toml"
    data = checked(path, "", read_toml(path), KEYS[""])
    experiment = checked(path, "experiment", data["experiment"], KEYS["experiment"])
    tables = [checked(path, f"run {n}", run, KEYS["run"]) for n, run in enumerate(data["run"], 1)]
    interval = float(experiment["output_interval"])
    scenario = Scenario(
        folder=folder.resolve(),
        title=data["title"],
        asks=data.get("asks", ""),
        stop_time=float(experiment["stop_time"]),
        output_interval=interval,
        reference_interval=float(experiment.get("reference_interval", interval)),
        look_at=tuple(experiment.get("look_at", LOOK_AT)),
        start=data.get("start", {}),
        runs=tuple(
            Run(run["name"], run.get("label", run["name"]), run["fmu"], run.get("start", {}))
            for run in tables
        ),
        tolerance=checked_rules(path, data.get("tolerance", {})),
        input=folder / experiment["input"] if "input" in experiment else None,
    )
    if not 0.0 < interval <= scenario.stop_time:
        raise UserError(f"{path}: needs 0 < output_interval <= stop_time, both in seconds")
    if len({run.name for run in scenario.runs}) < len(tables):
        raise UserError(f"{path}: needs at least one [[run]], and no name twice")
    for run in scenario.runs:
        if not re.fullmatch(FILE_NAME, run.name):
            raise UserError(f"{path}: the run's name {run.name!r} must do as a file's name")
    rows = scenario.reference_interval / interval
    if not (rows > 0.5 and abs(rows - round(rows)) < 1e-9):
        raise UserError(f"{path}: reference_interval must be a multiple of output_interval")
    return scenario


def find(folder: Path) -> list[Scenario]:
    """All scenarios below a folder, by name."""
    found = sorted(path.parent for path in folder.glob("*/scenario.toml"))
    if not found:
        raise UserError(f"{folder}: no scenarios here (folders with a scenario.toml)")
    return [load(path) for path in found]
