"""The trolley with the first modes as a linear system, and its regulator, which weighs jerk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from ..plant.chain import Array
from ..plant.linear import TautString


def design_model(string: TautString, modes: int, lag: float = 0.0) -> tuple[Array, Array]:
    """xdot = A x + B a_cmd of the trolley and the first ``modes`` modes, SI units.

    x = [trolley.x, trolley.v, then for each mode its share of payload.x_rel and its rate; with a
    lag the trolley's acceleration last]; per mode q'' + alpha q' + omega^2 q = -gamma (a + alpha
    v), gamma = phi_n phi^T b, and lag a' = a_cmd - a.
    """
    size = 2 + 2 * modes + (lag > 0.0)
    A, B = np.zeros((size, size)), np.zeros((size, 1))
    moved = np.zeros(size)  # by the trolley's acceleration
    A[0, 1] = moved[1] = 1.0
    for mode in range(modes):
        q, rate = 2 + 2 * mode, 3 + 2 * mode
        gamma = string.modes.shapes[-1, mode] * string.push[mode]
        A[q, rate] = 1.0
        A[rate, q] = -(string.modes.omega[mode] ** 2)
        A[rate, rate] = -string.air
        A[rate, 1] = -gamma * string.air
        moved[rate] = -gamma
    if lag > 0.0:
        A[:, -1] = moved
        A[-1, -1], B[-1, 0] = -1.0 / lag, 1.0 / lag
    else:
        B[:, 0] = moved
    return A, B


def discretised(A: Array, B: Array, h: float) -> tuple[Array, Array]:
    """x(h) = Ad x(0) + Bd a with a held: one matrix exponential of [A B; 0 0] h."""
    size = len(A)
    both = np.zeros((size + 1, size + 1))
    both[:size, :size], both[:size, size:] = A, B
    grown = expm(both * h)
    return grown[:size, :size], grown[:size, size:]


@dataclass(frozen=True)
class Weights:
    """Deviations that weigh alike in the regulator's cost (Bryson & Ho 1975)."""

    position: float  # m
    sway: float  # m, in mode 1
    waves: float  # m, in each mode beyond it
    acceleration: float  # m/s2
    jerk: float  # m/s3


def regulator(Ad: Array, Bd: Array, h: float, modes: int, weights: Weights) -> Array:
    """Gain K, (size + 1,), of the jerk j = -K [x; a] that makes a_cmd over the next step a + h j.

    It minimises the sum of x^T Q x + a^2/acceleration^2 + j^2/jerk^2; Q weighs position and each
    mode's sway by their weights. K = (R + B^T S B)^-1 B^T S A with S from
    scipy.linalg.solve_discrete_are.
    """
    size = len(Ad)
    A = np.block([[Ad, Bd], [np.zeros((1, size)), np.ones((1, 1))]])
    B = h * np.vstack((Bd, np.ones((1, 1))))
    Q = np.zeros(size + 1)
    Q[0] = weights.position**-2
    Q[2 : 2 + 2 * modes : 2] = weights.waves**-2
    Q[2] = weights.sway**-2
    Q[-1] = weights.acceleration**-2
    R = np.array([[weights.jerk**-2]])
    S = solve_discrete_are(A, B, np.diag(Q), R)
    K: Array = np.linalg.solve(R + B.T @ S @ B, B.T @ S @ A)[0]
    return K
