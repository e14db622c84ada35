"""Steps that are all or nothing: outputs that are finite numbers, or a model as it was."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from math import isfinite
from typing import Any

from .errors import BadValue

FINITE_STEP = "inputs and a step that keep it finite"


def check_finite(values: Mapping[str, float], allowed: str) -> None:
    """Raise BadValue for the first of some outputs by name that is not a finite number."""
    for name, value in values.items():
        if not isfinite(value):
            raise BadValue(name, value, allowed)


class WholeSteps(ABC):
    """A model that replaces what it holds, and edits none of it in place: a step can be undone."""

    @abstractmethod
    def step(self, h: float, told: Any) -> None:
        """Advance by ``h`` s; raises CraneError, the model as it was."""

    @abstractmethod
    def outputs(self) -> dict[str, float]:
        """All outputs by their FMU names, in SI units, in the interface's order."""

    def output_values(self) -> list[float]:
        """All outputs in the interface's order, in SI units."""
        return list(self.outputs().values())

    def advance(self, h: float, told: Any) -> list[float]:
        """Advance by ``h`` s; the outputs then, in the interface's order, all of them finite.

        Raises CraneError, the model as it was, where that cannot be had.
        """
        kept = self.keep()
        try:
            self.step(h, told)
            seen = self.output_values()
            if not all(map(isfinite, seen)):
                check_finite(self.outputs(), FINITE_STEP)
        except Exception:
            self.undo(kept)
            raise
        return seen

    def keep(self) -> Any:
        """What :meth:`undo` needs, to be as now."""
        return vars(self).copy()

    def undo(self, kept: Any) -> None:
        """Be as when ``kept`` was kept."""
        vars(self).update(kept)
