"""The steady-state Kalman filter of the taut string: its matrices, its Riccati equation.

State z = [omega eta; eta'] of the string's modes, m sqrt(kg)/s: free motion turns it, so that
all of its matrices are well scaled. Disturbances: a force on the payload and an acceleration of the
trolley, each held from sample to sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, solve_discrete_are

from ..plant.chain import Array
from ..plant.linear import TautString

OBSERVABLE = 1e-6  # smallest observability margin that can be designed for


class NoFilter(Exception):
    """There is no steady-state filter; the message says why."""


@dataclass(frozen=True)
class Noise:
    """Standard deviations that the filter assumes."""

    force: float  # N, on the payload, held over sample_time
    acceleration: float  # m/s2, of the trolley, held over sample_time
    measurement: float  # m or rad, of each sample
    sample_time: float  # s


def transition(string: TautString, t: float) -> Array:
    """Phi(t) of z(t) = Phi z(0), free motion, (2n, 2n): a turn of each mode, damped by the air.

    Per mode [s' + alpha s, omega s; -omega s, s'], s as in :func:`linear.free_response`.
    """
    omega = string.modes.omega
    s, s_dot = string.response(t)
    turn = np.diag(omega * s)
    return np.block([[np.diag(s_dot + string.air * s), turn], [-turn, np.diag(s_dot)]])


def held_input(string: TautString, t: float) -> Array:
    """Gamma(t): z after ``t`` s of 1 N on the payload, and of 1 m/s2 of the trolley, (2n, 2).

    Per mode [omega (1 - s' - alpha s)/omega^2; s] p with the modal load p, from rest.
    """
    omega = string.modes.omega
    s, s_dot = string.response(t)
    load = np.column_stack((string.modes.shapes[-1], -string.push))
    moved = (1.0 - s_dot - string.air * s) / omega
    return np.vstack((moved[:, None] * load, s[:, None] * load))


def held_noise(string: TautString, noise: Noise, interval: float, t: float) -> Array:
    """Q: covariance of z after ``t`` s, from none, of disturbances held over ``interval`` s.

    Q = Gamma(t) diag(force^2, acceleration^2) Gamma(t)^T sample_time/interval: held longer, they
    are weaker, so that their power at low frequency stays.
    """
    gamma = held_input(string, t) * np.array([noise.force, noise.acceleration])
    return np.asarray(gamma @ gamma.T * (noise.sample_time / interval))


def observability(phi: Array, c: Array) -> float:
    """Smallest singular value of [Phi - lambda; c/|c|] over Phi's eigenvalues (Popov, Hautus).

    0: some motion never shows in the samples.
    """
    unit = c / np.linalg.norm(c)
    identity = np.eye(len(phi))
    stacks = (np.vstack((phi - root * identity, unit)) for root in np.linalg.eigvals(phi))
    return min(float(np.linalg.svd(stack, compute_uv=False)[-1]) for stack in stacks)


@dataclass(frozen=True)
class Filter:
    """A steady-state filter for samples every ``interval`` s."""

    interval: float  # s
    gain: Array  # (2n,), z gained per unit of innovation
    prior: Array  # (2n, 2n), error covariance of z just before a sample
    posterior: Array  # the same, just after


def steady_state(string: TautString, noise: Noise, c: Array, interval: float) -> Filter:
    """The filter for samples y = c z + v every ``interval`` s, v of noise.measurement.

    P = Phi (P - k c P) Phi^T + Q, k = P c^T/(c P c^T + r): the discrete Riccati equation, by
    scipy.linalg.solve_discrete_are. Raises NoFilter where the samples cannot show some motion.
    """
    phi = transition(string, interval)
    margin = observability(phi, c)
    if not margin >= OBSERVABLE:
        raise NoFilter(f"some motion hardly shows in these samples (margin {margin:.1e})")
    Q = held_noise(string, noise, interval, interval)
    r = np.array([[noise.measurement**2]])
    try:
        P = solve_discrete_are(phi.T, c[:, None], Q, r)
    except (LinAlgError, ValueError) as error:
        raise NoFilter(f"the Riccati equation has no solution ({error})") from None
    seen = P @ c
    gain = seen / (float(c @ seen) + noise.measurement**2)
    keep = np.eye(len(c)) - np.outer(gain, c)
    posterior = keep @ P @ keep.T + np.outer(gain, gain) * noise.measurement**2  # Joseph's form
    if not (np.isfinite(gain).all() and np.abs(np.linalg.eigvals(phi @ keep)).max() < 1.0):
        raise NoFilter("the Riccati equation's solution is not stable")
    return Filter(interval, gain, P, posterior)


def predicted(string: TautString, noise: Noise, found: Filter, t: float) -> Array:
    """Error covariance of z ``t`` s after a sample was used, none having been used since."""
    P = found.posterior
    while t > 0.0:
        span = min(t, found.interval)
        phi = transition(string, span)
        P = phi @ P @ phi.T + held_noise(string, noise, found.interval, span)
        t -= found.interval
    return P
