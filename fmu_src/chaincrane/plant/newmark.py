"""The paper's scheme: Newmark's average acceleration, steps I to VI of its section 2.1.

Deviations from the paper, each for a reason:
- Convergence is asked of the out-of-balance force too. The paper's test, on displacements alone,
  passes with a steel chain when 100 N are out of balance against a weight of 6 N.
- Positions are relative to the trolley, whose motion is known exactly; its acceleration is a load.
- Damping, which the paper leaves out, is added: C v with the air's and the chain's part.
It is not safe with stiff chains: the caller checks every step's energy balance.
"""

from __future__ import annotations

import numpy as np

from ..errors import NotConverged
from . import banded
from .chain import (
    Array,
    DiscreteChain,
    along_elements,
    applied_force,
    axial_force,
    carried_force,
    element_tangent,
    internal_force,
    mass_times,
    payload_work,
)
from .command import Command
from .jump import plain_jump
from .scheme import Jump, Load, Motion, StepResult

MOST_NEWMARK_ITERATIONS = 200
LOOKED_BACK_AT = 20  # iteration by which corrections must have shrunk
SHRUNK = 1e-2  # to this part of the first one, or the step is given up
DISPLACEMENT_TOLERANCE = 1e-6  # step V (f): of |q|
FORCE_TOLERANCE = 1e-8  # of the weight of chain and payload, besides
FORCE_ROUND_OFF = 2e-16  # of EA n: a position's last digit times an element's stiffness


class Newmark:
    """Steps a chain with the paper's scheme."""

    def __init__(self, chain: DiscreteChain) -> None:
        self.chain = chain
        crane = chain.crane
        self._mass = banded.mass_bands(chain)
        weight = crane.gravity * crane.total_mass
        self._force_tolerance = (
            FORCE_TOLERANCE * weight + FORCE_ROUND_OFF * crane.chain.EA * chain.elements
        )

    def jump(self, motion: Motion, command: Command, trolley_v: float, dv: float) -> Jump:
        """The mass matrix' own impulse."""
        return plain_jump(self.chain, motion, dv)

    def start(self, motion: Motion, load: Load) -> Motion:
        """Step I: accelerations from dynamic equilibrium, M a = f - f_sigma - C v."""
        if motion.a is not None:
            return motion
        applied = applied_force(self.chain, load.command, load.trolley_v)
        out_of_balance = applied - self._resisting(motion.r, motion.w)
        a = banded.solve(self._mass.copy(), out_of_balance)
        if a is None:
            raise NotConverged("the mass matrix is singular")
        return Motion(motion.r, motion.w, motion.tension, a)

    def step(self, motion: Motion, load: Load, h: float) -> StepResult:
        """Steps II to VI for one step of ``h`` seconds. Raises NotConverged."""
        chain = self.chain
        damping = chain.crane.damping
        r, w, a = motion.r, motion.w, motion.a
        assert a is not None, "call start() before the first step"
        d = along_elements(r)

        # II. effective stiffness (15), kept through the iterations; 2/h C for the damping
        tangent = element_tangent(d, chain.L0, chain.crane.chain.EA)
        if damping.chain:
            c = d / np.hypot(d[:, 0], d[:, 1])[:, None]
            viscosity = chain.crane.chain.EA * damping.chain / chain.L0
            tangent += 2.0 / h * viscosity * c[:, :, None] * c[:, None, :]
        inertia = 4.0 / h**2 + 2.0 / h * damping.air
        factors = banded.Factors(banded.add_tangents(inertia * self._mass, tangent))
        if factors.singular:
            raise NotConverged.singular(h)

        # III-IV. effective load (16) and a first increment (17); V. iteration (18)-(23)
        applied = applied_force(chain, load.command, load.trolley_v_after(h))
        increment = np.zeros_like(r)
        correction, first = increment, 0.0
        for iteration in range(MOST_NEWMARK_ITERATIONS + 1):
            a1 = 4.0 / h**2 * increment - 4.0 / h * w - a  # (18)
            w1 = 2.0 / h * increment - w  # (19)
            r1 = r + increment  # (20)
            residual = applied - mass_times(chain, a1) - self._resisting(r1, w1)  # (21)
            if iteration:
                moved = float(np.linalg.norm(correction) / np.linalg.norm(r1))
                unbalanced = float(np.abs(residual).max())
                if moved <= DISPLACEMENT_TOLERANCE and unbalanced <= self._force_tolerance:
                    tension = self._tension(r1, w1)
                    end = Motion(r1, w1, tension, a1)
                    return self._result(motion, load, h, end, iteration)
                first = moved if iteration == 1 else first
                if not moved < 1.0 or (iteration == LOOKED_BACK_AT and moved > SHRUNK * first):
                    break
            correction = factors.solve(residual)  # (17), (22)
            increment = increment + correction  # (23)
        raise NotConverged.in_step(h, iteration)

    def _resisting(self, r: Array, w: Array) -> Array:
        """Internal forces and damping relative to the trolley, N, (n, 2)."""
        d = along_elements(r)
        force = internal_force(d, self._axial(d, np.hypot(d[:, 0], d[:, 1]), w))
        if air := self.chain.crane.damping.air:
            force += air * mass_times(self.chain, w)
        return force

    def _tension(self, r: Array, w: Array) -> Array:
        """Axial force of each element, N, (n,)."""
        d = along_elements(r)
        return self._axial(d, np.hypot(d[:, 0], d[:, 1]), w)

    def _axial(self, d: Array, length: Array, w: Array) -> Array:
        chain = self.chain.crane.chain
        force = axial_force(chain.EA, self.chain.L0, length)
        if tau := self.chain.crane.damping.chain:
            rate = np.einsum("ij,ij->i", d, along_elements(w)) / length
            force = force + chain.EA * tau / self.chain.L0 * rate
        return force

    def trolley_force(self, motion: Motion, command: Command, trolley_v: float) -> float:
        """Horizontal force of the drive on the chain, N: node 0's row of dynamic equilibrium."""
        assert motion.a is not None
        inertia = motion.a[:, 0] + self.chain.crane.damping.air * motion.w[:, 0]
        carried = carried_force(self.chain, command, trolley_v, inertia[0], inertia[-1])
        d, w = along_elements(motion.r)[:1], motion.w[:1]
        length = np.hypot(d[:, 0], d[:, 1])
        return float(carried - self._axial(d, length, w)[0] * d[0, 0] / length[0])

    def _result(
        self, motion: Motion, load: Load, h: float, end: Motion, iterations: int
    ) -> StepResult:
        """Step VI, (24)-(26), done; the step's energy terms by the trapezoidal rule."""
        trolley_v1 = load.trolley_v_after(h)
        trolley_dx = 0.5 * h * (load.trolley_v + trolley_v1)
        before = self.trolley_force(motion, load.command, load.trolley_v)
        after = self.trolley_force(end, load.command, trolley_v1)
        return StepResult(
            motion=end,
            trolley_fx=after,
            work_trolley=0.5 * (before + after) * trolley_dx,
            work_payload=payload_work(load.command, end.r[-1] - motion.r[-1], trolley_dx),
            dissipated=self._damping_work(motion, load.trolley_v, end, trolley_v1, trolley_dx),
            iterations=iterations,
        )

    def _damping_work(
        self, start: Motion, v0: float, end: Motion, v1: float, trolley_dx: float
    ) -> float:
        """What the damping takes in a step, J: mean of its forces at both ends times the path."""
        chain, damping = self.chain, self.chain.crane.damping
        path = end.r - start.r
        work = 0.0
        if damping.chain:
            viscous = self._viscous_pull(start) + self._viscous_pull(end)
            work += 0.5 * float(np.vdot(viscous, along_elements(path)))
        if damping.air:
            w, v = 0.5 * (start.w + end.w), 0.5 * (v0 + v1)
            total = chain.crane.total_mass
            momentum = float(chain.row_mass @ w[:, 0]) + total * v
            work += damping.air * (
                float(np.vdot(path, mass_times(chain, w)))
                + v * float(chain.row_mass @ path[:, 0])
                + momentum * trolley_dx
            )
        return work

    def _viscous_pull(self, motion: Motion) -> Array:
        chain = self.chain.crane.chain
        d = along_elements(motion.r)
        length = np.hypot(d[:, 0], d[:, 1])
        viscous = self._axial(d, length, motion.w) - axial_force(chain.EA, self.chain.L0, length)
        return (viscous / length)[:, None] * d
