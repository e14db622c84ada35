"""A host's times: they come with round-off, as each host adds them up in its own way."""

from __future__ import annotations

from math import floor, isfinite

TIME_TOLERANCE = 1e-9  # s below 1 s, else of a time: what adding up many steps may amount to
TIME_ROUND_OFF = 1e-15  # of a time: what a few roundings of it amount to


def is_now(at: float, reached: float, h: float) -> bool:
    """Whether a step of ``h`` s that begins ``at`` begins at the time ``reached``, s."""
    return abs(at - reached) <= _within(TIME_TOLERANCE + TIME_ROUND_OFF * abs(reached), h)


def is_beyond(end: float, stop: float, h: float) -> bool:
    """Whether a step of ``h`` s to ``end`` goes beyond the time ``stop``, s."""
    return end > stop + _within(TIME_TOLERANCE * max(1.0, abs(stop)), h)


def _within(tolerance: float, h: float) -> float:
    """A tolerance in time, s, but never so much that a step could be left out or done twice."""
    return 0.5 * h if 0.0 < 0.5 * h < tolerance else tolerance


def meant_step(at: float, h: float, unit: float) -> float:
    """``h`` s as it was meant, without the round-off of the times that a host took it from.

    A whole number of ``unit`` s where it is one but for that; else ``h``. So 0.005 and
    41.005 - 41.0 are the same step, at any time.
    """
    ratio = h / unit + 0.5
    if not (ratio >= 1.0 and isfinite(ratio)):
        return h
    whole = floor(ratio) * unit
    return whole if abs(h - whole) <= TIME_ROUND_OFF * (abs(at) + h) else h
