"""The chain that does not stretch: Gauss points carry its tangent, explicit steps move it.

    y ^
      |        trolley, motion prescribed, on y = 0
      +----->  o======> x, the direction of travel
           x   :        s_q   Gauss points of the chain's length, m, w_q their weights, sum L
                \\       u_q   unit tangent at s_q, downwards along the chain
                 \\      n_q   = (-u_qy, u_qx), across it; om_q its turning rate, rad/s
                  o     payload, a point mass

The chain's tangent is the polynomial of degree p - 1 through u_1..u_p. So its shape is one of
degree p, r(s) = sum W_q(s) u_q, whose stretch is none at the Gauss points, and its end, the
payload, is at sum w_q u_q. There is no axial stiffness, and nothing that vibrates along the chain.

A motion is kept as in the truss, by nodes: those of the polygon r_q = sum_(k<=q) w_k u_k, whose
last one is the payload. Its links have the lengths w_q; the masses of the chain couple them all.

Source: ours, but for Lagrange, Gauss and Legendre; the mass of the fast modes is mended after the
modes of a finer chain, :func:`mended_inertia`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import inf, sqrt

import numpy as np

from ..errors import NotConverged
from .chain import Array, DiscreteChain, along_elements, payload_work
from .command import IDLE, Command
from .crane import Posture, material_fractions
from .parameters import Crane, Numerics
from .scheme import Jump, Load, Motion, StepResult

LONGEST_TURN = 0.5  # rad, of the fastest mode in a step
SMOOTH_ENERGY_TOLERANCE = 1e-6  # of the energy put in so far, what a step may be off by
FOURTH_ORDER_SHARE = 0.0667  # 1/(2^4 - 1), Richardson's
FASTEST_TURN = 2.0  # rad, the same, where the tension has grown; a longer step is halved


def legendre(degree: int, y: Array) -> Array:
    """P_(-1) = -1 by convention, P_0, ..., P_degree at ``y`` from -1 to 1, (degree + 2, len(y)).

    Then the integral of (2j + 1) P_j from -1 to y is P_(j+1) - P_(j-1), for j = 0 too.
    """
    rows = [-np.ones_like(y), np.ones_like(y), y]
    for j in range(2, degree + 1):
        rows.append(((2 * j - 1) * y * rows[j] - (j - 1) * rows[j - 1]) / j)
    return np.array(rows[: degree + 2])


@dataclass(frozen=True)
class GaussChain:
    """Constant arrays of a chain with p Gauss points."""

    crane: Crane
    places: Array  # (p,), Gauss points from -1 at the trolley to 1 at the payload
    weights: Array  # m, (p,), their weights, sum L
    load: Array  # kg m, (p,), b: weight and trolley act on u_q by it
    inertia: Array  # kg m2, (p, p), S

    @property
    def points(self) -> int:
        """How many Gauss points there are, p."""
        return len(self.weights)


def shapes(places: Array, weights: Array, y: Array) -> Array:
    """W_q(s) of r(s) = sum W_q(s) u_q, m, (len(y), p), at ``y`` = 2 s/L - 1.

    W_q = w_q/2 sum_(j<p) P_j(x_q) (P_(j+1)(y) - P_(j-1)(y)): the integral of the polynomial that is
    1 at x_q and 0 at the other Gauss points.
    """
    p = len(places)
    at_points = legendre(p, places)[1 : p + 1]
    at_y = legendre(p, y)
    return np.asarray(0.5 * weights * ((at_y[2:] - at_y[:p]).T @ at_points))


def top_slopes(places: Array, weights: Array) -> Array:
    """W_q'(0), (p,): the tangent at the trolley is their sum with u_q; P_j(-1) = (-1)^j."""
    p = len(places)
    j = np.arange(p)
    at_points = legendre(p, places)[1 : p + 1]
    return np.asarray(weights / weights.sum() * ((2 * j + 1) * (-1.0) ** j @ at_points))


def gauss_chain(crane: Crane, points: int) -> GaussChain:
    """The chain with plain inertia, S_qr = mu int W_q W_r ds + M w_q w_r, b_q = int W_q dm."""
    L, M = crane.chain.length, crane.payload.mass
    mu = crane.chain.mass / L
    places, weights = np.polynomial.legendre.leggauss(points)
    weights = 0.5 * L * weights
    load = weights * (M + 0.5 * mu * L * (1.0 - places))
    y, share = np.polynomial.legendre.leggauss(points + 1)  # exact for a degree of 2 p + 1
    W = shapes(places, weights, y)
    inertia = 0.5 * mu * L * (W.T * share) @ W + M * np.outer(weights, weights)
    return GaussChain(crane, places, weights, load, inertia)


def inverse_modes(chain: GaussChain) -> tuple[Array, Array]:
    """g/omega^2, m, (p,), slowest mode first, and V: modes of B^(-1/2) S B^(-1/2), (p, p).

    Small sway of the hanging chain: S phi'' + g B phi = 0, B = diag(b).
    """
    root = np.sqrt(chain.load)
    values, vectors = np.linalg.eigh(chain.inertia / np.outer(root, root))
    return values[::-1], vectors[:, ::-1]


def mended_inertia(chain: GaussChain) -> tuple[Array, float]:
    """S with the frequencies of a finer chain for the hanging chain's modes, and the fastest one.

    S := B^(1/2) V diag(g/omega_ref^2) V' B^(1/2), kg m2, (p, p); omega_ref are the first p of
    2 p + 2 Gauss points, right to 1e-6 for the paper's payloads. A polynomial's own fast modes are
    much too fast: they would cost short steps and tell nothing. Returns omega_p, rad/s, too.
    """
    _, V = inverse_modes(chain)
    values, _ = inverse_modes(gauss_chain(chain.crane, 2 * chain.points + 2))
    values = values[: chain.points]
    shaped = np.sqrt(chain.load)[:, None] * V
    fastest = sqrt(chain.crane.gravity / float(values[-1]))
    return np.asarray(shaped * values @ shaped.T), fastest


@dataclass(frozen=True)
class Turning:
    """Tangents and their rates: what moves."""

    u: Array  # (p, 2), unit vectors
    om: Array  # rad/s, (p,)


# An explicit Runge-Kutta scheme of order 4 with five stages, ours: Kutta's 3/8 rule, whose second
# stage comes by a midpoint. For each stage its place in the step, and the shares of the stages
# before; then the shares in the step. An oscillation loses (omega h)^8/1728 of its energy in a
# step, where the classical scheme's loses (omega h)^6/72, and its phase is six times as exact.
STAGES: tuple[tuple[float, tuple[float, ...]], ...] = (
    (0.0, ()),
    (1 / 6, (1 / 6,)),
    (1 / 3, (0.0, 1 / 3)),
    (2 / 3, (1 / 3, -2 / 3, 1.0)),
    (1.0, (0.0, 1.0, -1.0, 1.0)),
)
SHARES = (1 / 8, 0.0, 3 / 8, 3 / 8, 1 / 8)


def moved(start: Turning, rates: list[Turning], shares: Iterable[float], h: float) -> Turning:
    """``start`` moved for ``h`` s by as much of each of the ``rates`` as ``shares`` says."""
    u, om = start.u, start.om
    for share, rate in zip(shares, rates, strict=True):
        u, om = u + h * share * rate.u, om + h * share * rate.om
    return Turning(u, om)


def across(u: Array) -> Array:
    """n = (-u_y, u_x), (p, 2)."""
    return np.column_stack((-u[:, 1], u[:, 0]))


class InextensibleChain:
    """Gauss tangents and explicit steps: what formulation.py and scheme.py ask for.

    damping.chain and chain.EA have no place here: nothing stretches.
    """

    never_slack = True
    step_energy_tolerance = SMOOTH_ENERGY_TOLERANCE

    def __init__(self, chain: DiscreteChain, numerics: Numerics) -> None:
        plain = gauss_chain(chain.crane, numerics.elements)
        inertia, self.fastest = mended_inertia(plain)
        self.chain = GaussChain(plain.crane, plain.places, plain.weights, plain.load, inertia)
        self.longest_step = LONGEST_TURN / self.fastest
        self.wave_step = inf  # no axial waves
        y = 2.0 * material_fractions() - 1.0
        self._shapes = shapes(plain.places, plain.weights, y)
        self._slopes = top_slopes(plain.places, plain.weights)
        self._hanging = chain.crane.gravity * plain.load / plain.weights  # N, (p,)

    @property
    def scheme(self) -> InextensibleChain:
        """Its own."""
        return self

    @staticmethod
    def error_share(slack: bool) -> float:
        """Of fourth order, whether slack or not."""
        return FOURTH_ORDER_SHARE

    # --- the motion by nodes and by tangents --------------------------------------------------

    def _turning(self, motion: Motion) -> Turning:
        u = along_elements(motion.r) / self.chain.weights[:, None]
        rate = along_elements(motion.w)
        return Turning(u, np.einsum("ij,ij->i", across(u), rate) / self.chain.weights)

    def _motion(self, turning: Turning, tension: Array) -> Motion:
        u, w = turning.u, self.chain.weights[:, None]
        r = np.cumsum(w * u, axis=0)
        return Motion(r, np.cumsum(w * turning.om[:, None] * across(u), axis=0), tension)

    def straight(self, sway_angle: float) -> Motion:
        """Tangents at the sway angle, and the tension in the instant of release."""
        u = np.tile([np.sin(sway_angle), -np.cos(sway_angle)], (self.chain.points, 1))
        turning = Turning(u, np.zeros(self.chain.points))
        force = self.applied_force(IDLE, 0.0)
        return self._motion(
            turning, self.tension(turning, self.acceleration(turning, force), force)
        )

    def posture(self, motion: Motion) -> Posture:
        """Points of the polynomial; the top's direction is its tangent at the trolley."""
        u = self._turning(motion).u
        points = self._shapes @ u
        return Posture(points, self._slopes @ u, motion.r[-1], motion.w[-1])

    # --- energies and momentum ----------------------------------------------------------------

    def potential(self, r: Array) -> float:
        """g sum b_q (u_qy + 1), J."""
        height = along_elements(r)[:, 1] / self.chain.weights + 1.0
        return self.chain.crane.gravity * float(self.chain.load @ height)

    def momentum(self, w: Array) -> float:
        """sum b_q u'_qx, kg m/s."""
        return float(self.chain.load @ (along_elements(w)[:, 0] / self.chain.weights))

    def energy(self, motion: Motion, trolley_v: float) -> float:
        """(M + m) v^2/2 + v sum b_q u'_qx + sum S_qr u'_q . u'_r/2 + potential, J."""
        return self._kinetic(motion.w, trolley_v) + self.potential(motion.r)

    def _kinetic(self, w: Array, trolley_v: float) -> float:
        rate = along_elements(w) / self.chain.weights[:, None]
        relative = 0.5 * float(np.vdot(rate, self.chain.inertia @ rate))
        total = self.chain.crane.total_mass
        return relative + trolley_v * self.momentum(w) + 0.5 * total * trolley_v**2

    # --- dynamics -----------------------------------------------------------------------------

    def applied_force(self, command: Command, trolley_v: float) -> Array:
        """F_q = (fx w_q - b_q (a + alpha v), -g b_q), N m, (p, 2)."""
        chain, crane = self.chain, self.chain.crane
        carried = command.trolley_a_cmd + crane.damping.air * trolley_v
        pushed = command.payload_fx * chain.weights - carried * chain.load
        return np.column_stack((pushed, -crane.gravity * chain.load))

    def acceleration(self, turning: Turning, force: Array) -> Array:
        """om' = al of tangents under ``force`` F, rad/s2, (p,).

        sum_r S_qr u_q.u_r (al_r + alpha om_r) = n_q.F_q + sum_r S_qr om_r^2 n_q.u_r
        """
        u, om, S = turning.u, turning.om, self.chain.inertia
        n = across(u)
        load = np.einsum("ij,ij->i", n, force) + (S * (n @ u.T)) @ om**2
        return np.asarray(np.linalg.solve(S * (u @ u.T), load) - self.chain.crane.damping.air * om)

    def tension(self, turning: Turning, al: Array, force: Array) -> Array:
        """T_q = u_q.(F_q - sum_r S_qr (u''_r + alpha u'_r))/w_q, N, (p,).

        u'' = al n - om^2 u, u' = om n.
        """
        u, om = turning.u, turning.om
        n = across(u)
        turned = al + self.chain.crane.damping.air * om
        inertia = self.chain.inertia @ (turned[:, None] * n - (om**2)[:, None] * u)
        return np.asarray(np.einsum("ij,ij->i", u, force - inertia) / self.chain.weights)

    def released_force(self, motion: Motion, trolley_v: float) -> float:
        """(M + m)(a + alpha v) + sum b_q (u''_qx + alpha u'_qx), N, at rest relative to it."""
        turning = self._turning(motion)
        al = self.acceleration(turning, self.applied_force(IDLE, trolley_v))
        carried = self.chain.crane.total_mass * self.chain.crane.damping.air * trolley_v
        return carried + float(self.chain.load @ (al * across(turning.u)[:, 0]))

    def jump(self, motion: Motion, command: Command, trolley_v: float, dv: float) -> Jump:
        """sum_r S_qr u_q.u_r dom_r = -n_qx b_q dv, and the tension after it."""
        before = self._turning(motion)
        u = before.u
        push = -dv * self.chain.load * across(u)[:, 0]
        dom = np.linalg.solve(self.chain.inertia * (u @ u.T), push)
        after = Turning(u, before.om + dom)
        force = self.applied_force(command, trolley_v)
        tension = self.tension(after, self.acceleration(after, force), force)
        jumped = self._motion(after, tension)
        return Jump(Motion(motion.r, jumped.w, tension), jumped.w - motion.w)

    def start(self, motion: Motion, load: Load) -> Motion:
        """Nothing to prepare."""
        return motion

    def step(self, motion: Motion, load: Load, h: float) -> StepResult:
        """One explicit Runge-Kutta step, see :data:`STAGES`; raises NotConverged, h too long.

        Tension is the mean of those at h/3 and 2 h/3; the drive's force is the step's mean,

            F = [P + alpha ((M + m) x + sum b_q u_qx)]_0^h/h - fx,

        P the horizontal momentum, so that all of it is accounted for; its work is
        [P v] - a int P dt - fx dx + alpha int P v dt, the last by the scheme's own quadrature.
        """
        fast = self.fastest * sqrt(max(1.0, float((motion.tension / self._hanging).max())))
        if not h * fast <= FASTEST_TURN:
            raise NotConverged.in_step(h, 1)
        start = self._turning(motion)
        seen: list[Turning] = []
        rates: list[Turning] = []
        tensions = []
        for place, shares in STAGES:
            at = moved(start, rates, shares, h)
            force = self.applied_force(load.command, load.trolley_v_after(place * h))
            al = self.acceleration(at, force)
            seen.append(at)
            rates.append(Turning(at.om[:, None] * across(at.u), al))
            tensions.append(self.tension(at, al, force))
        end = moved(start, rates, SHARES, h)
        end = Turning(end.u / np.hypot(end.u[:, 0], end.u[:, 1])[:, None], end.om)
        tension = 0.5 * (tensions[2] + tensions[3])
        w = [motion.w, *(self._motion(seen[i], tension).w for i in (2, 3))]
        return self._result(motion, w, self._motion(end, tension), load, h)

    def _result(
        self, motion: Motion, w: list[Array], end: Motion, load: Load, h: float
    ) -> StepResult:
        """Energy terms of a step; ``w``: the nodes' velocities, m/s, at 0, h/3 and 2 h/3."""
        crane, command = self.chain.crane, load.command
        total, air, a = crane.total_mass, crane.damping.air, command.trolley_a_cmd
        v = [load.trolley_v_after(t * h / 3.0) for t in range(4)]
        w = [*w, end.w]
        dx, moved_payload = h * load.trolley_v_after(0.5 * h), end.r[-1] - motion.r[-1]
        path = self.momentum(end.r) - self.momentum(motion.r) + total * dx  # int P dt
        P = [self.momentum(one) + total * at for one, at in zip(w, v, strict=True)]
        gained = P[3] - P[0]
        work = P[3] * v[3] - P[0] * v[0] - a * path - command.payload_fx * dx
        dissipated = 0.0
        if air:
            share = [air * h / 8.0 * times for times in (1.0, 3.0, 3.0, 1.0)]
            work += sum(s * p * at for s, p, at in zip(share, P, v, strict=True))
            taken = (s * self._kinetic(one, at) for s, one, at in zip(share, w, v, strict=True))
            dissipated = 2.0 * sum(taken)
        fx = (gained + air * path) / h - command.payload_fx
        work_payload = payload_work(command, moved_payload, dx)
        return StepResult(end, fx, work, work_payload, dissipated, 1)
