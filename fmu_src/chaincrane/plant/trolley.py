"""The trolley: its motion is prescribed, and known exactly in time."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, isfinite

from ..errors import BadValue
from ..variables import check_rows, check_step_size
from .command import Command

MAX_INTERNAL_STEPS = 10_000_000  # in a communication step
WHOLE = 1e-9  # of a ratio: so near to a whole number it counts as whole


@dataclass(frozen=True)
class Trolley:
    """The trolley moves at v_cmd + integral of a_cmd; a change of v_cmd is a jump of velocity."""

    x: float = 0.0  # m
    v: float = 0.0  # m/s
    gained: float = 0.0  # m/s, integral of a_cmd since the start

    def commanded(self, command: Command) -> float:
        """Velocity, m/s, that ``command`` asks for at this instant."""
        return command.trolley_v_cmd + self.gained

    def after(self, h: float, command: Command) -> Trolley:
        """The trolley after ``h`` seconds of a held command."""
        v, a = self.commanded(command), command.trolley_a_cmd
        gained = self.gained + h * a
        return Trolley(self.x + h * v + 0.5 * h * h * a, command.trolley_v_cmd + gained, gained)


def equal_parts(h: float, longest: float) -> int:
    """Number of equal parts of ``h`` seconds, none longer than ``longest``.

    A ratio that is whole but for round-off, 13 ms over 1 ms, counts as whole.
    """
    return max(1, ceil(h / longest * (1.0 - WHOLE)))


def checked_after(trolley: Trolley, h: float, command: Command) -> Trolley:
    """The trolley after a step; raises BadValue where its motion does not stay finite."""
    after = trolley.after(h, command)
    if not (isfinite(after.x) and isfinite(after.v)):
        allowed = "a command that keeps the trolley's motion finite"
        raise BadValue("trolley.v_cmd", command.trolley_v_cmd, allowed)
    return after


def checked_move(trolley: Trolley, max_step: float, h: float, command: Command) -> Trolley:
    """The trolley after a communication step; raises BadValue for a value that is not allowed."""
    check_rows(command)
    check_step_size(h)
    if h > MAX_INTERNAL_STEPS * max_step:
        allowed = f"at most {MAX_INTERNAL_STEPS} internal steps of solver.max_step"
        raise BadValue("step size", h, allowed)
    return checked_after(trolley, h, command)
