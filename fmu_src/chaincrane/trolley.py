"""The trolley: its motion is prescribed, and known exactly in time."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

from .errors import BadValue
from .parameters import check_number

MAX_INTERNAL_STEPS = 10_000_000  # in a communication step


@dataclass(frozen=True)
class Trolley:
    """The trolley moves at v_cmd + integral of a_cmd; a change of v_cmd is a jump of velocity."""

    x: float = 0.0  # m
    v: float = 0.0  # m/s
    gained: float = 0.0  # m/s, integral of a_cmd since the start

    def commanded(self, v_cmd: float) -> float:
        """Velocity, m/s, that ``v_cmd`` asks for at this instant."""
        return v_cmd + self.gained

    def after(self, h: float, v_cmd: float, a_cmd: float) -> Trolley:
        """The trolley after ``h`` seconds of held commands."""
        v = v_cmd + self.gained
        gained = self.gained + h * a_cmd
        return Trolley(self.x + h * v + 0.5 * h * h * a_cmd, v_cmd + gained, gained)


def checked_move(
    trolley: Trolley, max_step: float, h: float, v_cmd: float, a_cmd: float, payload_fx: float
) -> Trolley:
    """The trolley after a communication step; raises BadValue for a value that is not allowed."""
    check_number("trolley.v_cmd", v_cmd)
    check_number("trolley.a_cmd", a_cmd)
    check_number("payload.fx", payload_fx)
    check_number("step size", h, "a finite number above 0, s", test=lambda v: v > 0)
    if h > MAX_INTERNAL_STEPS * max_step:
        allowed = f"at most {MAX_INTERNAL_STEPS} internal steps of solver.max_step"
        raise BadValue("step size", h, allowed)
    after = trolley.after(h, v_cmd, a_cmd)
    if not (isfinite(after.x) and isfinite(after.v)):
        raise BadValue("trolley.v_cmd", v_cmd, "a command that keeps the trolley's motion finite")
    return after
