"""How far off in time: a second solution, whose steps are twice as long, is carried along.

Where the motion is smooth and the scheme of second order, the finer solution is off by a third of
the difference of the two (Richardson); after jumps and changes of load the order lies between two
and one, so that it is a half, give or take. Where the chain has been slack the order is one, so
that it is all of it, and half as much again is told, for it varies more. A formulation of fourth
order tells a fifteenth. Of forces it is twice as much. What is told is the largest so far. It sees
the time error, and where the motion is one that a small change makes another one of; the mesh's
error it does not see.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot

from .chain import Array
from .scheme import Motion

# How many times the payload's share forces have: they show waves that are less well resolved. With
# once, 42 to 49 of the torture study's 1200 cases were told less than a third; with twice, 8.
FORCE_SHARE = 2.0
# Of the chain's length: a motion whose told error is larger counts as unpredictable. The true one
# is within a factor of three as a rule, and was 20 times as large once, after a slack.
UNPREDICTABLE = 0.005


@dataclass(frozen=True)
class TimeError:
    """Estimated time errors, the largest since the start."""

    payload: float = 0.0  # m
    tension_top: float = 0.0  # N
    trolley_fx: float = 0.0  # N

    def seen(
        self, payload: float, tension_top: float, trolley_fx: float, share: float
    ) -> TimeError:
        """With the differences of the two solutions after one more step of the longer ones.

        ``share``: of the payloads' distance, what the error is told to be.
        """
        return TimeError(
            max(self.payload, share * payload),
            max(self.tension_top, FORCE_SHARE * share * tension_top),
            max(self.trolley_fx, FORCE_SHARE * share * trolley_fx),
        )

    def lost(self, length: float) -> TimeError:
        """Where the solution with longer steps has failed: not to be told, so ``length``, m."""
        return replace(self, payload=max(self.payload, length))

    def predictable(self, length: float) -> bool:
        """Whether a motion of a chain of ``length`` m still counts as predictable."""
        return self.payload <= UNPREDICTABLE * length


def apart(a: Motion, b: Motion) -> float:
    """Distance of two motions' payloads, m."""
    gap: Array = a.r[-1] - b.r[-1]
    return hypot(float(gap[0]), float(gap[1]))
