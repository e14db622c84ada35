"""A move: an acceleration that is constant piece by piece, from a velocity at its begin."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from ..variables import ABOVE_ZERO, parameter


@dataclass(frozen=True)
class Limits:
    """What the trolley's drive can do."""

    velocity: float = parameter(
        "limit.velocity", "m/s", 0.5, "largest speed of the trolley", minimum=ABOVE_ZERO
    )
    acceleration: float = parameter(
        "limit.acceleration", "m/s2", 1.0, "largest acceleration of the trolley", minimum=ABOVE_ZERO
    )


@dataclass(frozen=True)
class Move:
    """Accelerations ``a[k]``, m/s2, from ``times[k]`` to ``times[k + 1]``, s since its begin."""

    times: tuple[float, ...] = (0.0,)
    a: tuple[float, ...] = ()

    @property
    def end(self) -> float:
        """When it is over, s since its begin."""
        return self.times[-1]

    def mean(self, t: float, h: float) -> float:
        """Mean acceleration, m/s2, from ``t`` to ``t + h`` s; none before the move and after."""
        first = max(0, bisect_right(self.times, t) - 1)
        gained = 0.0
        for k in range(first, len(self.a)):
            start, end = max(self.times[k], t), min(self.times[k + 1], t + h)
            if end <= start:
                break
            if start == t and end == t + h:
                return self.a[k]  # free of round-off, however short the step
            gained += self.a[k] * (end - start)
        return gained / h

    def scaled(self, factor: float) -> Move:
        """The same move with all accelerations times ``factor``."""
        return Move(self.times, tuple(factor * a for a in self.a))


def from_cells(a: Sequence[float], dt: float) -> Move:
    """A move of cells of ``dt`` s each."""
    return Move(tuple(dt * k for k in range(len(a) + 1)), tuple(float(one) for one in a))


def joined(first: Move, pause: float, second: Move) -> Move:
    """``first``, ``pause`` s at its last velocity, then ``second``."""
    begin = first.end + pause
    times = (*first.times, *(begin + t for t in second.times))
    return Move(times, (*first.a, 0.0, *second.a))


def together(moves: Sequence[tuple[float, float, Move]]) -> Move:
    """The sum of moves, each delayed by seconds and times a factor: what a shaper makes of one."""
    times = sorted({delay + t for delay, _, move in moves for t in move.times} | {0.0})
    middles = [0.5 * (start + end) for start, end in pairwise(times)]
    a = [
        sum(
            factor * move.a[bisect_right(move.times, t - delay) - 1]
            for delay, factor, move in moves
            if move.times[0] <= t - delay < move.end
        )
        for t in middles
    ]
    return Move(tuple(times), tuple(a))
