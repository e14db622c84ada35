"""The trolley: its motion is prescribed, and known exactly in time."""

from __future__ import annotations

from dataclasses import dataclass


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
