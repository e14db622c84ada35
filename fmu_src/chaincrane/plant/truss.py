"""The paper's chain of truss elements as a formulation, with the scheme of the settings."""

from __future__ import annotations

from collections.abc import Callable
from math import inf

import numpy as np

from . import banded
from .chain import (
    Array,
    DiscreteChain,
    along_elements,
    applied_force,
    axial_force,
    carried_force,
    internal_force,
    interpolation,
    kinetic_energy,
    potential_energy,
    straight_chain,
)
from .command import IDLE
from .crane import Posture, material_fractions
from .energy_momentum import EnergyMomentum
from .jump import wave_step
from .newmark import Newmark
from .parameters import Numerics
from .scheme import Motion, Scheme

SCHEME_CLASSES: dict[str, Callable[[DiscreteChain], Scheme]] = {
    "energy_momentum": EnergyMomentum,
    "newmark": Newmark,
}
STEP_ENERGY_TOLERANCE = 1e-3  # of the energy put in so far, what a step may be off by
TAUT_SHARE = 0.5  # of the payloads' distance, what the time error is told to be
SLACK_SHARE = 1.5  # the same, since the chain has been slack


class Truss:
    """Truss elements with the scheme of the settings; see :class:`~.formulation.Formulation`."""

    longest_step = inf
    never_slack = False
    step_energy_tolerance = STEP_ENERGY_TOLERANCE

    def __init__(self, chain: DiscreteChain, numerics: Numerics) -> None:
        self.chain = chain
        self.scheme: Scheme = SCHEME_CLASSES[numerics.scheme](chain)
        self.wave_step = wave_step(chain) if numerics.scheme == "energy_momentum" else inf
        self._interpolation = interpolation(chain.elements, material_fractions())

    @staticmethod
    def error_share(slack: bool) -> float:
        """companion.py says why."""
        return SLACK_SHARE if slack else TAUT_SHARE

    def straight(self, sway_angle: float) -> Motion:
        """Each element under the tension in the instant of its release."""
        chain = self.chain
        r = straight_chain(chain, sway_angle)
        length = np.hypot(*along_elements(r).T)
        return Motion(r, np.zeros_like(r), axial_force(chain.crane.chain.EA, chain.L0, length))

    def potential(self, r: Array) -> float:
        """Elastic energy and weight, J."""
        return potential_energy(self.chain, r)

    def energy(self, motion: Motion, trolley_v: float) -> float:
        """Kinetic, elastic and gravity energy, J."""
        return kinetic_energy(self.chain, motion.w, trolley_v) + self.potential(motion.r)

    def momentum(self, w: Array) -> float:
        """Row sums of the mass matrix times the nodes' velocities, kg m/s."""
        return float(self.chain.row_mass @ w[:, 0])

    def released_force(self, motion: Motion, trolley_v: float) -> float:
        """Force of the drive, N: node 0's row of dynamic equilibrium."""
        chain, v = self.chain, trolley_v
        d = along_elements(motion.r)
        hangs = motion.r[-1, 0] == 0.0  # in balance, which round-off would not be
        pull = chain.weight if hangs else internal_force(d, motion.tension)
        force = applied_force(chain, IDLE, v) - pull
        a = banded.Factors(banded.mass_bands(chain)).solve(force)[:, 0]
        carried = carried_force(chain, IDLE, v, float(a[0]), float(a[-1]))
        return carried - float(motion.tension[0] * d[0, 0] / np.hypot(d[0, 0], d[0, 1]))

    def posture(self, motion: Motion) -> Posture:
        """Points on the elements; the top's direction is the first element's."""
        points = self._interpolation @ motion.r
        return Posture(points, node1=motion.r[0], payload=motion.r[-1], payload_w=motion.w[-1])
