"""The model that observer and controller are designed from: a crane as they believe it to be."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np

from ..plant.chain import discretise
from ..plant.parameters import Crane, Initial, Numerics, check
from ..variables import Variable, choice, parameter, row_of, rows, whole
from ..whole_step import WholeSteps
from .modes import MESH, StringModes

MODELS = ("modes", "chain", "pendulum")
INPUTS_AT = ("start", "end")
MAX_DESIGN_ELEMENTS = 50
MAX_MODES = 10
SHOWN_MODES = 4
_LENGTHS = 256  # of steps, whose keys are kept


Own = TypeVar("Own", bound="Carried")


class Carried:
    """What a part carries from step to step: a step changes a copy, which takes its place."""

    def copy(self: Own) -> Own:
        """A copy of what is carried; what it refers to is never changed in place."""
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__)
        return other


class ControlPart(WholeSteps):
    """What observer and controller have alike: they are run step by step, like a crane.

    In what is done at every step a product is ``dot``: of so few numbers ``@`` takes twice as long.
    """

    start_time = 0.0  # s, the host's
    _state: Any  # Carried

    def save(self) -> bytes:
        """The whole state, bit for bit (a float's repr is exact); the settings are not in it."""
        return json.dumps(vars(self._state), default=_plain).encode()

    def notice(self) -> str | None:
        """Nothing: what a part does is told by its outputs."""
        return None


def _plain(part: Any) -> Any:
    """What JSON has no word for in a state: an array, or a dataclass."""
    return part.tolist() if isinstance(part, np.ndarray) else asdict(part)


# The crane's parameters that a taut string, which does not stretch, has a use for.
CRANE_ROWS = tuple(row for row in rows(Crane) if row.name != "damping.chain")
MASS_MATRIX = row_of(Numerics, "mass_matrix")


def design_rows(settings: Any) -> tuple[Variable, ...]:
    """The rows of an observer's or a controller's settings."""
    return tuple(row for row in rows(settings) if row.name != "damping.chain")


def model_choice(part: str) -> Any:
    """The field that chooses the model that a part is designed from; ``part`` begins its name."""
    meaning = (
        f"{', '.join(MODELS)}: the first modes of the string, all modes of a few elements, or a"
        " massless rope"
    )
    return choice(f"{part}.model", MODELS[0], MODELS, meaning)


def elements_choice(part: str) -> Any:
    """The field with the number of elements of the model ``chain``."""
    meaning = "number of finite elements of the model chain; no effect in the others"
    return whole(f"{part}.elements", 2, (1, MAX_DESIGN_ELEMENTS), meaning)


def drive_lag() -> Any:
    """The field with the drive's lag."""
    return parameter(
        "drive.lag",
        "s",
        0.0,
        "time constant with which the trolley's acceleration follows trolley.a_cmd: 0 for a crane"
        " of ours, which follows at once",
        minimum=0.0,
        nominal=0.1,
    )


@lru_cache(_LENGTHS)
def step_key(h: float) -> float:
    """``h`` s without the round-off of a host's clock: what designs are kept by."""
    return float(f"{h:.9g}")


def check_design(crane: Crane, mass_matrix: str, speed: float = 0.0) -> None:
    """Raise BadValue for the first value of the believed crane that is not allowed."""
    check(crane, Initial(speed), Numerics(mass_matrix=mass_matrix))


def design_string(
    crane: Crane, model: str, elements: int, modes: int, mass_matrix: str
) -> StringModes:
    """The string that stands for ``model``: a pendulum is one massless element."""
    if model == "modes":
        return StringModes(discretise(crane, MESH, mass_matrix), modes)
    if model == "pendulum":
        crane, elements = replace(crane, chain=replace(crane.chain, mass=0.0)), 1
    return StringModes(discretise(crane, elements, mass_matrix), elements)
