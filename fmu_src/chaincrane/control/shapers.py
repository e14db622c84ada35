"""Open-loop moves: the plain fastest one, and the same given in parts so that the swings cancel."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, exp, pi, sqrt

from .move import Limits, Move, together

_WHOLE = 1.0 - 1e-9  # a ratio that is whole but for round-off counts as whole


def trapezoid(distance: float, limits: Limits, h: float) -> Move:
    """The fastest move from rest to rest whose phases are whole steps of ``h`` s.

    n steps of acceleration a, m of cruise, n of braking: distance = a h^2 n (n + m). On this grid
    the held command is the move itself, so it ends where it should.
    """
    length = abs(distance)
    V, A = limits.velocity, limits.acceleration
    if length * A <= V * V:  # never reaches the limit of velocity
        n, m = max(1, ceil(sqrt(length / A) / h * _WHOLE)), 0
    else:
        n = max(1, ceil(V / (A * h) * _WHOLE))
        m = max(0, ceil(length / (V * h) * _WHOLE) - n)
    a = distance / (h * h * n * (n + m))
    return Move((0.0, n * h, (n + m) * h, (2 * n + m) * h), (a, 0.0, -a))


def _swing(omega: float, air: float) -> tuple[float, float] | None:
    """Half a damped period, s, and what of a swing is left after it; None: overdamped.

    k = exp(-zeta pi/sqrt(1 - zeta^2)), zeta = alpha/(2 omega).
    """
    zeta = 0.5 * air / omega
    if zeta >= 1.0:
        return None
    turned = sqrt(1.0 - zeta**2)
    return pi / (omega * turned), exp(-zeta * pi / turned)


def zv_shaped(move: Move, omega: float, air: float) -> Move:
    """The move given twice, half a period apart, so that the two swings of a mode cancel.

    Zero-vibration shaper (Singer & Seering 1990): impulses 1 and k, by their sum.
    """
    swing = _swing(omega, air)
    if swing is None:
        return move
    half, k = swing
    return together([(0.0, 1.0 / (1.0 + k), move), (half, k / (1.0 + k), move)])


def zvd_shaped(move: Move, omegas: Sequence[float], air: float) -> Move:
    """The move given thrice for each mode: the residual's slope over frequency is zero, too.

    Zero vibration and derivative (Singer & Seering 1990): impulses 1, 2 k and k^2, half a period
    apart, by their sum (1 + k)^2.
    """
    for omega in omegas:
        swing = _swing(omega, air)
        if swing is not None:
            half, k = swing
            whole = (1.0 + k) ** 2
            parts = ((0.0, 1.0), (half, 2.0 * k), (2.0 * half, k * k))
            move = together([(delay, factor / whole, move) for delay, factor in parts])
    return move
