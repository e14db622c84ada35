"""A row of an FMU's interface, and how rows make settings: built from values, and checked.

A settings dataclass is its own table: each field carries its row, so that a parameter's name, unit,
start value, range and meaning stand once, where the models read it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cache
from math import isfinite
from operator import attrgetter
from typing import Any, TypeVar

from .errors import BadValue

ABOVE_ZERO = 2.2250738585072014e-308  # smallest normal number: the "above 0" of a closed range
FINITE = "a finite number"
_ROW = "variable"
_FLOATS = frozenset((float,))

Settings = TypeVar("Settings")


@dataclass(frozen=True)
class Variable:
    """One row of an interface; its value reference is its place in the interface's tuple."""

    name: str
    causality: str  # input, parameter, output; in this order in an interface
    unit: str | None
    start: float | int | str | None  # None: calculated
    meaning: str
    kind: str = "Real"  # Real, Integer, String
    minimum: float | None = None
    maximum: float | None = None
    nominal: float | None = None
    discrete: bool = False  # a Real that jumps, as a count does
    choices: tuple[str, ...] = ()  # of a String
    words: str | None = None  # what is allowed, where the range does not say it well
    starts_from: tuple[str, ...] = ()  # parameters that an output's first value depends on
    starts_from_linear: tuple[str, ...] | None = None  # the same in the linear crane, if others

    @property
    def allowed(self) -> str:
        """What a value may be, in words."""
        if self.words is not None:
            return self.words
        if self.choices:
            return "one of " + ", ".join(self.choices)
        if self.kind == "Integer":
            return f"a whole number from {self.minimum} to {self.maximum}"
        if self.minimum is None:
            return FINITE
        return f"{FINITE} above 0" if self.minimum == ABOVE_ZERO else f"{FINITE}, 0 or above"

    @property
    def symbol(self) -> str:
        """Its name in C, and as a field of an input: trolley.v_cmd -> trolley_v_cmd."""
        return self.name.replace(".", "_").replace("[", "_").replace("]", "")

    def check(self, value: object) -> None:
        """Raise BadValue unless ``value`` is allowed."""
        if not self._allows(value):
            raise BadValue(self.name, value, self.allowed)

    def _allows(self, value: object) -> bool:
        if self.kind == "String":
            return value in self.choices
        kinds = int if self.kind == "Integer" else (float, int)
        return (
            isinstance(value, kinds)
            and not isinstance(value, bool)
            and isfinite(value)
            and (self.minimum is None or value >= self.minimum)
            and (self.maximum is None or value <= self.maximum)
        )


NOMINAL = {"N": 10.0, "1/s": 0.1, "rad": 0.1, "J": 0.1, "kg": 0.1}  # by unit; 1 in the others


def _filled(variable: Variable) -> Variable:
    """``variable`` with the nominal value of its unit, where it is Real and has none."""
    if variable.kind != "Real" or variable.nominal is not None:
        return variable
    return replace(variable, nominal=NOMINAL.get(variable.unit or "", 1.0))


def held_input(name: str, unit: str, meaning: str) -> Any:
    """A dataclass's field that is a Real input; zero where nothing is connected."""
    return field(default=0.0, metadata={_ROW: _filled(Variable(name, "input", unit, 0.0, meaning))})


def parameter(name: str, unit: str | None, start: float | str, meaning: str, **more: Any) -> Any:
    """A dataclass's field that is a parameter, fixed when initialisation ends."""
    row = _filled(Variable(name, "parameter", unit, start, meaning, **more))
    return field(default=start, metadata={_ROW: row})


def choice(name: str, start: str, choices: tuple[str, ...], meaning: str) -> Any:
    """A dataclass's field that is a String parameter, one of ``choices``."""
    return parameter(name, None, start, meaning, kind="String", choices=choices)


def whole(name: str, start: int, span: tuple[int, int], meaning: str) -> Any:
    """A dataclass's field that is an Integer parameter, from the first of ``span`` to its last."""
    low, high = span
    return parameter(name, None, start, meaning, kind="Integer", minimum=low, maximum=high)


def output(name: str, unit: str | None, meaning: str, **more: Any) -> Variable:
    """An output, calculated."""
    return _filled(Variable(name, "output", unit, None, meaning, **more))


def count(name: str, meaning: str) -> Variable:
    """An output that counts, 0 or above. A Real: there are tools that read every output as one."""
    return output(name, None, meaning, minimum=0.0, discrete=True)


def rows(settings: type) -> tuple[Variable, ...]:
    """The rows of a settings dataclass and of those inside it, in the order of its fields."""
    return tuple(row for row, _ in _places(settings))


@cache
def _places(settings: type) -> tuple[tuple[Variable, str], ...]:
    """Each row of a settings dataclass with its field's name, dotted where it is inside another."""
    found: list[tuple[Variable, str]] = []
    for entry in fields(settings):
        inner = entry.default_factory
        if _ROW in entry.metadata:
            found.append((entry.metadata[_ROW], entry.name))
        elif is_dataclass(inner):
            found += [(row, f"{entry.name}.{name}") for row, name in _places(inner)]
    return tuple(found)


@cache
def _readers(settings: type) -> tuple[tuple[Variable, Callable[[Any], Any]], ...]:
    """Each row with what reads its value in an instance: checks come at every step."""
    return tuple((row, attrgetter(name)) for row, name in _places(settings))


def row_of(settings: type, name: str) -> Variable:
    """The row of a settings dataclass's field ``name``."""
    row: Variable = next(row for row, place in _places(settings) if place.split(".")[-1] == name)
    return row


def shared(settings: Any, name: str) -> Any:
    """A field with the row and the start value of another dataclass's field ``name``."""
    row = row_of(settings, name)
    return field(default=row.start, metadata={_ROW: row})


def from_values(settings: type[Settings], values: Mapping[str, Any]) -> Settings:
    """An instance from the FMU's values by name; what is not named has its start value."""
    chosen: dict[str, Any] = {}
    for entry in fields(settings):  # type: ignore[arg-type]  # a dataclass
        if _ROW in entry.metadata:
            row = entry.metadata[_ROW]
            chosen[entry.name] = values.get(row.name, row.start)
        elif is_dataclass(entry.default_factory):
            chosen[entry.name] = from_values(entry.default_factory, values)
    return settings(**chosen)


def values_of(settings: Any) -> dict[str, Any]:
    """The FMU's values by name of a settings instance: what :func:`from_values` takes."""
    return {row.name: value(settings) for row, value in _readers(settings.__class__)}


@cache
def _numbers(settings: type) -> Callable[[Any], tuple[Any, ...]] | None:
    """What reads all values at once where any finite number is allowed for each; else None."""
    places = _places(settings)
    free = all((row.kind, row.minimum, row.maximum) == ("Real", None, None) for row, _ in places)
    return attrgetter(*(name for _, name in places)) if free and len(places) > 1 else None


def check_rows(settings: Any) -> None:
    """Raise BadValue for the first value of a settings instance that is not allowed."""
    numbers = _numbers(settings.__class__)
    if numbers is not None:  # the inputs of a step: a sum tells of all whether they are finite
        values = numbers(settings)
        if _FLOATS.issuperset(map(type, values)) and isfinite(sum(values)):
            return
    for row, value in _readers(settings.__class__):
        row.check(value(settings))


def check_number(
    name: str, value: Any, allowed: str = FINITE, *, above: float | None = None
) -> None:
    """Raise BadValue unless ``value`` is a finite number, and larger than ``above`` if given."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not isfinite(value):
        raise BadValue(name, value, allowed)
    if above is not None and not value > above:
        raise BadValue(name, value, allowed)


def check_step_size(h: Any) -> None:
    """Raise BadValue unless ``h`` is a length of a communication step."""
    check_number("step size", h, f"{FINITE} above 0, s", above=0.0)


# The base units of FMI 2.0, as exponents: what each unit of the table is made of.
UNITS: Mapping[str, Mapping[str, int]] = {
    "m": {"m": 1},
    "m/s": {"m": 1, "s": -1},
    "m/s2": {"m": 1, "s": -2},
    "m/s3": {"m": 1, "s": -3},
    "kg": {"kg": 1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "N.s": {"kg": 1, "m": 1, "s": -1},
    "s": {"s": 1},
    "1/s": {"s": -1},
    "rad": {"rad": 1},
}
