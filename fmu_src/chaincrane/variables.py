"""What a row of an FMU's interface is, and the units that rows are given in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

TINY = 2.2250738585072014e-308  # smallest normal number: the "above 0" of a closed range


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


NOMINAL = {"N": 10.0, "1/s": 0.1, "rad": 0.1, "J": 0.1, "kg": 0.1}  # by unit; 1 in the others


def _filled(variable: Variable) -> Variable:
    """``variable`` with the nominal value of its unit, where it is Real and has none."""
    if variable.kind != "Real" or variable.nominal is not None:
        return variable
    return replace(variable, nominal=NOMINAL.get(variable.unit or "", 1.0))


def input_variable(name: str, unit: str, meaning: str) -> Variable:
    """A Real input, zero where nothing is connected."""
    return _filled(Variable(name, "input", unit, 0.0, meaning))


def parameter(
    name: str, unit: str | None, start: float | str, meaning: str, **more: Any
) -> Variable:
    """A parameter, fixed when initialisation ends."""
    return _filled(Variable(name, "parameter", unit, start, meaning, **more))


def output(name: str, unit: str | None, meaning: str, **more: Any) -> Variable:
    """An output, calculated."""
    return _filled(Variable(name, "output", unit, None, meaning, **more))


# The base units of FMI 2.0, as exponents: what each unit of the table is made of.
UNITS: Mapping[str, Mapping[str, int]] = {
    "m": {"m": 1},
    "m/s": {"m": 1, "s": -1},
    "m/s2": {"m": 1, "s": -2},
    "kg": {"kg": 1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "s": {"s": 1},
    "1/s": {"s": -1},
    "rad": {"rad": 1},
}
