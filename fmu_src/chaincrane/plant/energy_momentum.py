"""The default scheme: an energy-momentum conserving midpoint rule for truss elements.

Simo & Tarnow, The discrete energy-momentum method, ZAMP 43 (1992) 757-792, with the force as a
discrete gradient of the elastic energy: Gonzalez, Time integration and discrete Hamiltonian
systems, J. Nonlinear Sci. 6 (1996) 449-467. Energy changes in a step by the work of the trolley
and the payload's force less the damping, whatever the step. A little viscosity along the elements
takes out the axial vibrations that a step cannot resolve. It acts on the change of the stretching
from one step to the next: what is resolved stretches by nearly the same in both, and is left alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import NotConverged
from . import banded
from .chain import (
    Array,
    DiscreteChain,
    along_elements,
    applied_force,
    assemble_force,
    axial_force,
    carried_force,
    kinetic_energy,
    mass_times,
    payload_work,
)
from .command import Command
from .jump import filtered_jump
from .scheme import Jump, Load, Motion, StepResult

# c: the viscous tension is c EA/L0 times what a step's stretch differs from the last one's by. An
# axial vibration that a step cannot resolve stretches back and forth, and keeps 1 - 8 c of itself.
AXIAL_DISSIPATION = 0.02
MOST_ITERATIONS = 12
CORRECTION_TOLERANCE = 1e-8  # of the chain's length; Newton's next error is its square
STILL = 4e-16  # of the chain's length: a correction that would only keep rest from resting
DIVERGENCE = 3.0  # a third or later correction that grows by this much is not worth another
LEAST_STRETCH = 0.1  # a correction that leaves less of an element's length is no correction


@dataclass(frozen=True)
class ElementForce:
    """Force of each element on its lower node over a step, and how it depends on the end."""

    pull: Array  # N, (n, 2)
    tangent: Array  # N/m, (n, 2, 2), derivative by the element's vector at the step's end
    tension: Array  # N, (n,)


@dataclass(frozen=True)
class Viscosity:
    """Viscous tension of each element over a step: eta (l1 - l0) - lag, N."""

    eta: float  # N/m
    lag: Array  # N, (n,), that of a stretch like the last step's

    def tension(self, stretch: Array) -> Array:
        """Viscous tension, N, of elements that stretch by so much, m, (n,)."""
        return self.eta * stretch - self.lag


def viscosity_of(chain: DiscreteChain, motion: Motion, h: float) -> Viscosity:
    """The chain's own damping, on the stretch, and the scheme's, on its change between steps.

    eta = EA/L0 (tau/h + c), lag = c EA/L0 q: q is what the last step stretched by, or as much of it
    as a shorter step would. After a start q = 0. The work of the second part, c EA/L0 (s - q) s, is
    c EA/L0 [(s - q)^2 + s^2 - q^2]/2: of it the last two terms are stored and come back, so that
    what is booked as dissipated can dip by them.
    """
    axial = chain.crane.chain.EA / chain.L0
    eta = axial * (chain.crane.damping.chain / h + AXIAL_DISSIPATION)
    if motion.stretched is None:
        return Viscosity(eta, np.zeros(chain.elements))
    again = min(1.0, h / motion.last_h) * motion.stretched
    return Viscosity(eta, axial * AXIAL_DISSIPATION * again)


def element_force(EA: float, L0: float, viscosity: Viscosity, d0: Array, d1: Array) -> ElementForce:
    """Discrete gradient of an element's elastic energy, with viscosity along the element.

    pull = k (d0 + d1)/2,  k = [EA/L0 (l0 + l1 - 2 L0) + 2 V]/(l0 + l1), V the viscous tension, so
    that pull . (d1 - d0) = EA/(2 L0) [(l1 - L0)^2 - (l0 - L0)^2] + V (l1 - l0) exactly.
    ``d0``, ``d1``: element vectors at the step's start and end, (n, 2), m.
    """
    l0 = np.hypot(d0[:, 0], d0[:, 1])
    l1 = np.hypot(d1[:, 0], d1[:, 1])
    total = l0 + l1
    axial = EA / L0
    elastic = 0.5 * (axial_force(EA, L0, l0) + axial_force(EA, L0, l1))
    tension = elastic + viscosity.tension(l1 - l0)
    k = 2.0 * tension / total
    middle = 0.5 * (d0 + d1)
    slope = (axial + 2.0 * viscosity.eta - k) / (total * l1)
    tangent = (slope[:, None] * middle)[:, :, None] * d1[:, None, :]
    tangent[:, 0, 0] += 0.5 * k
    tangent[:, 1, 1] += 0.5 * k
    return ElementForce(k[:, None] * middle, tangent, tension)


def turned(d: Array, angle: Array, factor: Array) -> Array:
    """Element vectors (n, 2) turned by about ``angle`` rad and stretched by ``factor``, (n,).

    The turn is 2 atan(angle/2), exact in length: the Cayley map, which is what the scheme itself
    makes of a steady rotation.
    """
    t = 0.5 * angle
    scale = factor / (1.0 + t * t)
    cos, sin = (1.0 - t * t) * scale, 2.0 * t * scale
    return np.column_stack((cos * d[:, 0] - sin * d[:, 1], sin * d[:, 0] + cos * d[:, 1]))


def cross(a: Array, b: Array) -> Array:
    """a_x b_y - a_y b_x of vectors (n, 2)."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def expected_stretch(EA: float, L0: float, viscosity: Viscosity, d: Array, tension: Array) -> Array:
    """Stretch factor of each element that would leave its ``tension``, N, as it was, (n,).

    Its length would not do: where a step cannot resolve the axial vibrations, a stiff chain's
    tension at the step's start is far from its mean over the step, and a wrong tension turns a
    fine mesh's light nodes anywhere.
    """
    length = np.hypot(d[:, 0], d[:, 1])
    change = tension - axial_force(EA, L0, length) + viscosity.lag
    return np.maximum(1.0 + change / ((0.5 * EA / L0 + viscosity.eta) * length), LEAST_STRETCH)


def corrected(d: Array, correction: Array) -> Array | None:
    """Element vectors (n, 2) turned and stretched as a ``correction`` of the nodes (n, 2) asks.

    To first order that adds the correction. But a sum would stretch a turning element by half the
    turn's square, which in a stiff chain is a force beyond all others. None: one would vanish.
    """
    dd = along_elements(correction)
    l2 = d[:, 0] ** 2 + d[:, 1] ** 2
    factor = 1.0 + np.einsum("ij,ij->i", d, dd) / l2
    if not np.all(factor > LEAST_STRETCH):
        return None
    return turned(d, cross(d, dd) / l2, factor)


class EnergyMomentum:
    """Steps a chain with the energy-momentum scheme."""

    def __init__(self, chain: DiscreteChain) -> None:
        self.chain = chain
        self._mass = banded.mass_bands(chain)

    def jump(self, motion: Motion, command: Command, trolley_v: float, dv: float) -> Jump:
        """A jump without the axial vibrations that no step resolves."""
        return filtered_jump(self.chain, motion, command, trolley_v, dv)

    def start(self, motion: Motion, load: Load) -> Motion:
        """The scheme keeps no accelerations: nothing to prepare."""
        return motion

    def step(self, motion: Motion, load: Load, h: float) -> StepResult:
        """One step of ``h`` seconds from ``motion`` under a constant ``load``.

        Solves, for the positions r1 at the step's end, with w1 = 2 (r1 - r0)/h - w0,

            M (w1 - w0)/h + alpha M (w0 + w1)/2 + F(r0, r1) = f - b (a + alpha v)

        where b are the mass matrix' row sums, a and v the trolley's acceleration and mean velocity,
        alpha the air's damping. Raises NotConverged.
        """
        chain, crane = self.chain, self.chain.crane
        air = crane.damping.air
        EA, L0 = crane.chain.EA, chain.L0
        viscosity = viscosity_of(chain, motion, h)
        steady = applied_force(chain, load.command, load.trolley_v_after(0.5 * h))
        inertia = 2.0 / h**2 + air / h
        inertia_bands = inertia * self._mass

        d0 = along_elements(motion.r)
        u = self._expected_velocity(motion, steady, h, d0)
        turn = h * cross(d0, along_elements(u)) / np.einsum("ij,ij->i", d0, d0)
        stretch = expected_stretch(EA, L0, viscosity, d0, motion.tension)
        d1: Array | None = turned(d0, turn, stretch)
        last = np.inf
        for iteration in range(1, MOST_ITERATIONS + 1):
            assert d1 is not None
            moved = np.cumsum(d1 - d0, axis=0)
            force = element_force(EA, L0, viscosity, d0, d1)
            change = inertia * moved - 2.0 / h * motion.w
            residual = steady - mass_times(chain, change) - assemble_force(force.pull)
            correction = banded.solve(banded.add_tangents(inertia_bands, force.tangent), residual)
            if correction is None:
                break
            size = float(np.abs(correction).max())
            if not size < crane.chain.length or (iteration > 2 and size > DIVERGENCE * last):
                break
            if size > STILL * crane.chain.length:
                d1 = corrected(d1, correction)
            if d1 is None:
                break
            if size <= CORRECTION_TOLERANCE * crane.chain.length:
                return self._result(motion, load, h, viscosity, (d0, d1), iteration)
            last = size
        raise NotConverged.in_step(h, iteration)

    def _expected_velocity(self, motion: Motion, steady: Array, h: float, d0: Array) -> Array:
        """Mean velocity of a step in which each element keeps its tension, or none if slack.

            ((2/h + alpha) M + h/2 K) u = 2/h M w0 + f - b (a + alpha v) - F(k d0),  k = N/l0

        with K the assembled k: the scheme's own step for a taut string, m/s, (n, 2). The rates at
        the step's start would not do: those of waves that the step cannot resolve come to nothing
        over it. ``steady`` is f - b (a + alpha v), N; ``d0`` the element vectors, m.
        """
        chain = self.chain
        k = np.maximum(motion.tension, 0.0) / np.hypot(d0[:, 0], d0[:, 1])
        inertia = 2.0 / h + chain.crane.damping.air
        diagonal = inertia * chain.mass_diagonal + 0.5 * h * k
        diagonal[:-1] += 0.5 * h * k[1:]
        coupling = inertia * chain.mass_coupling - 0.5 * h * k[1:]
        load = steady + 2.0 / h * mass_times(chain, motion.w) - assemble_force(k[:, None] * d0)
        return banded.solve_tridiagonal(diagonal, coupling, load)

    def _result(
        self,
        motion: Motion,
        load: Load,
        h: float,
        viscosity: Viscosity,
        vectors: tuple[Array, Array],
        n: int,
    ) -> StepResult:
        """Velocities and energy terms, once the element ``vectors`` of start and end are known."""
        chain, crane = self.chain, self.chain.crane
        d0, d1 = vectors
        moved = np.cumsum(d1 - d0, axis=0)  # at rest 0 to the last digit, which r1 - r0 is not
        r1 = motion.r + moved
        w1 = 2.0 / h * moved - motion.w
        trolley_v = load.trolley_v_after(0.5 * h)
        trolley_dx = h * trolley_v
        force = element_force(crane.chain.EA, chain.L0, viscosity, d0, d1)
        air = crane.damping.air
        mean_w = moved / h
        inertia = (w1[:, 0] - motion.w[:, 0]) / h + air * mean_w[:, 0]  # a + alpha w
        carried = carried_force(chain, load.command, trolley_v, inertia[0], inertia[-1])
        trolley_fx = carried - force.pull[0, 0]
        stretch = np.hypot(d1[:, 0], d1[:, 1]) - np.hypot(d0[:, 0], d0[:, 1])
        dissipated = float(viscosity.tension(stretch) @ stretch)
        if air:
            dissipated += 2.0 * air * h * kinetic_energy(chain, mean_w, trolley_v)
        return StepResult(
            motion=Motion(r1, w1, force.tension, stretched=stretch, last_h=h),
            trolley_fx=float(trolley_fx),
            work_trolley=float(trolley_fx) * trolley_dx,
            work_payload=payload_work(load.command, moved[-1], trolley_dx),
            dissipated=dissipated,
            iterations=n,
        )
