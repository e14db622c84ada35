"""The steady-state Kalman filter of the string: its matrices, its Riccati equation.

State z = [omega eta; eta'] of the string's modes, m sqrt(kg)/s: free motion turns it, so that
all of its matrices are well scaled. Disturbances: a force on the payload and an acceleration of the
trolley, each held from sample to sample. One more state may stand below them: an offset that
walks slowly, a steady wind on the payload or a bias of the sensor. It is measured by what it shows
in a sample at rest, and one of the two is all that one sensor can tell: at rest they look alike.

A mode whose frequency is believed wrongly turns away from its estimate, and a filter that is sure
of it answers with a phase that is anything: fed back, it can feed the mode. So the modes beyond the
first may wander, each as much as lets the filter follow it within a share of its frequency.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sqrt

import numpy as np
from scipy.linalg import LinAlgError, solve_discrete_are

from ..plant.chain import Array
from ..plant.command import Command
from ..plant.linear import ModalMotion, TautString

OBSERVABLE = 1e-6  # smallest observability margin that can be designed for
FAST = 0.95 * pi  # rad that a mode may turn between samples; what turns faster is not corrected
FAINT = 1e-4  # of the best seen mode's share in a sample; what shows less is not corrected


class NoFilter(Exception):
    """There is no steady-state filter; the message says why."""


class Unseen(NoFilter):
    """Some motion never shows in the samples."""


@dataclass(frozen=True)
class Noise:
    """Standard deviations that the filter assumes."""

    force: float  # N, on the payload, held over sample_time
    acceleration: float  # m/s2, of the trolley, held over sample_time
    measurement: float  # m or rad, of each sample
    sample_time: float  # s
    walk: float = 0.0  # of the offset, in a sample's unit by the root of a second
    waves: float = 0.0  # of their frequencies, at which modes beyond the first are followed


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


def driven(string: TautString, t: float) -> Array:
    """z after ``t`` s of the trolley's known motion, (2n, 3): a jump at their start, v and a.

    By 1 m/s, 1 m/s and 1 m/s2, from rest: the string's exact step is linear in them. Without air a
    steady v does nothing.
    """
    omega, rest = string.modes.omega, np.zeros_like(string.modes.omega)
    columns = []
    for dv, v, a in np.eye(3):
        motion = string.jump(ModalMotion(rest, rest), dv)
        moved = string.propagate(motion, t, v, Command(trolley_a_cmd=a))
        columns.append(np.append(omega * moved.eta, moved.rate))
    return np.column_stack(columns)


@dataclass(frozen=True)
class Watched:
    """A string, what a sensor sees of it, and the noise of both."""

    string: TautString
    c: Array  # (2n,), a sample by z; with an offset (2n + 1,)
    noise: Noise
    pull: float | None = None  # N of wind by unit of offset; 0: a bias; None: no offset

    def transition(self, t: float) -> Array:
        """Phi(t) of the whole state: an offset stays, and as a wind it drives the modes."""
        phi = transition(self.string, t)
        if self.pull is None:
            return phi
        driven = held_input(self.string, t)[:, :1] * self.pull
        return np.block([[phi, driven], [np.zeros((1, len(phi))), np.ones((1, 1))]])

    def driven(self, t: float) -> Array:
        """:func:`driven` of the whole state: the trolley moves no offset."""
        gamma = driven(self.string, t)
        return gamma if self.pull is None else np.vstack((gamma, np.zeros((1, 3))))

    def held_noise(self, interval: float, t: float) -> Array:
        """Q: covariance after ``t`` s, from none, of disturbances held over ``interval`` s.

        Q = Gamma(t) diag(force^2, acceleration^2) Gamma(t)^T sample_time/interval: held longer,
        they are weaker, so that their power at low frequency stays. An offset walks: walk^2 t; and
        so do the modes beyond the first.
        """
        noise, modal = self.noise, 2 * len(self.string.modes.omega)
        gamma = held_input(self.string, t) * np.array([noise.force, noise.acceleration])
        Q = np.zeros((len(self.c), len(self.c)))
        Q[:modal, :modal] = gamma @ gamma.T * (noise.sample_time / interval)
        Q[np.arange(modal), np.arange(modal)] += np.tile(self.wandering(), 2) * t
        if self.pull is not None:
            Q[-1, -1] = noise.walk**2 * t
        return Q

    def wandering(self) -> Array:
        """Intensity q of each mode's own walk in omega eta and eta', (n,).

        None in mode 1 and in those that samples do not correct. A mode that a sample shows by c
        omega eta is followed at c sqrt(q/(2 r^2 h)) 1/s, r the noise of a sample every h s: at
        beta omega with q = 2 r^2 h (beta omega/c)^2.
        """
        noise, omega = self.noise, self.string.modes.omega
        q = np.zeros_like(omega)
        corrected = self.corrected(noise.sample_time)
        waves = corrected[(corrected > 0) & (corrected < len(omega))]
        wide = noise.waves * omega[waves] / self.c[waves]
        q[waves] = 2.0 * noise.measurement**2 * noise.sample_time * wide**2
        return q

    def corrected(self, interval: float) -> Array:
        """Places in the state that samples every ``interval`` s correct, whole numbers.

        Mode 1 always; the others where they show and turn by less than half a turn between
        samples. The others run on uncorrected: no disturbance of the model moves them much either.
        """
        omega, n = self.string.modes.omega, len(self.string.modes.omega)
        shown = np.abs(self.c[:n] * omega) / np.abs(self.c[:n] * omega).max()
        keep = (omega * interval < FAST) & (shown > FAINT)
        keep[0] = True
        modes = np.flatnonzero(keep)
        offset = [] if self.pull is None else [2 * n]
        return np.concatenate((modes, n + modes, np.array(offset, dtype=int)))


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
    """A steady-state filter for samples every ``interval`` s; m states, an offset the last."""

    interval: float  # s
    gain: Array  # (m,), state gained per unit of innovation
    prior: Array  # (m, m), error covariance just before a sample
    posterior: Array  # the same, just after
    surprise: float  # standard deviation of an innovation


def steady_state(watched: Watched, interval: float) -> Filter:
    """The filter for samples y = c z + v every ``interval`` s, v of noise.measurement.

    P = Phi (P - k c P) Phi^T + Q, k = P c^T/(c P c^T + r): the discrete Riccati equation, by
    scipy.linalg.solve_discrete_are, in units of r. Raises Unseen where the samples cannot show
    some motion, and NoFilter where the noise leaves no solution.
    """
    kept = watched.corrected(interval)
    block = np.ix_(kept, kept)
    phi, c = watched.transition(interval)[block], watched.c[kept]
    modal = len(kept) // 2 * 2  # without the offset
    margin = observability(phi[:modal, :modal], c[:modal])
    if not margin >= OBSERVABLE:
        raise Unseen(f"some motion hardly shows in these samples (margin {margin:.1e})")
    r = watched.noise.measurement
    with np.errstate(all="ignore"):
        try:
            Q = watched.held_noise(interval, interval)[block] / r / r
            P = solve_discrete_are(phi.T, c[:, None], Q, np.eye(1))
            seen = P @ c
            spread = float(c @ seen) + 1.0
            gain = seen / spread
            keep = np.eye(len(c)) - np.outer(gain, c)
            posterior = keep @ P @ keep.T + np.outer(gain, gain)  # Joseph's form
            stable = np.abs(np.linalg.eigvals(phi @ keep)).max() < 1.0
        except (LinAlgError, ValueError, ZeroDivisionError) as error:
            raise NoFilter(f"the Riccati equation has no solution ({error})") from None
    if not (np.isfinite(gain).all() and stable):
        raise NoFilter("the Riccati equation's solution is not stable")
    size = len(watched.c)
    everywhere = np.zeros(size)
    everywhere[kept] = gain
    before, after = np.zeros((2, size, size))
    before[block], after[block] = P * r * r, posterior * r * r
    return Filter(interval, everywhere, before, after, r * sqrt(spread))


def predicted(watched: Watched, found: Filter, t: float) -> Array:
    """Error covariance ``t`` s after a sample was used, none having been used since."""
    P = found.posterior
    while t > 0.0:
        span = min(t, found.interval)
        phi = watched.transition(span)
        P = phi @ P @ phi.T + watched.held_noise(found.interval, span)
        t -= found.interval
    return P
