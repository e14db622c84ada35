"""Start values, checked against the FMU that they are for before anything runs."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from numbers import Integral, Real
from pathlib import Path
from typing import Any

from fmpy.model_description import ModelDescription

from .errors import UserError, instead

# FMI's name of a type -> what is asked for, in words.
ASKED = {
    "Real": "a finite number",
    "Integer": "a whole number, without a point",
    "Boolean": "true or false",
    "String": "a text in quotes",
}


def check_start_values(fmu: Path, description: ModelDescription, values: Mapping[str, Any]) -> None:
    """Raise UserError for a start value without a variable, of an output, or of another type.

    What range a value must be in is the FMU's to say.
    """
    variables = {variable.name: variable for variable in description.modelVariables}
    for name, value in values.items():
        if name not in variables:
            near = instead(name, (n for n, v in variables.items() if v.causality != "output"))
            raise UserError(f"{fmu}: there is no variable {name!r} to start with{near}")
        variable = variables[name]
        if variable.causality not in ("input", "parameter"):
            raise UserError(f"{fmu}: {name} is an {variable.causality}: it has no start value")
        if not _fits(variable.type, value):
            asked = ASKED.get(variable.type, variable.type)
            raise UserError(f"{fmu}: {name} = {value!r} is not allowed: {asked}")


def _fits(kind: str, value: Any) -> bool:
    if kind == "Boolean" or isinstance(value, bool):
        return kind == "Boolean" and isinstance(value, bool)
    if kind == "String":
        return isinstance(value, str)
    if kind == "Integer":
        return isinstance(value, Integral)
    return isinstance(value, Real) and isfinite(value)
