"""What the nonlinear crane asks of a formulation of its chain: the truss, or another one."""

from __future__ import annotations

from typing import Protocol

from .chain import Array
from .crane import Posture
from .scheme import Motion, Scheme


class Formulation(Protocol):
    """A chain with its payload, seen from the trolley, and the scheme that steps it."""

    longest_step: float  # s, what the scheme can take; inf where any will do
    wave_step: float  # s, what resolves the waves after a jump; inf where any step does
    never_slack: bool  # a motion with a tension below 0 is not one of a real chain
    step_energy_tolerance: float  # of the energy put in so far, what a step may be off by

    @property
    def scheme(self) -> Scheme:
        """What steps it."""

    def error_share(self, slack: bool) -> float:
        """Of the payloads' distance in two solutions, h and 2 h, what the time error is told to be.

        ``slack``: whether the chain has been slack since the start.
        """

    def straight(self, sway_angle: float) -> Motion:
        """The straight chain held at ``sway_angle`` rad, about to be released."""

    def potential(self, r: Array) -> float:
        """Potential energy, J, above the hanging equilibrium."""

    def energy(self, motion: Motion, trolley_v: float) -> float:
        """Mechanical energy, J, above the rest position."""

    def momentum(self, w: Array) -> float:
        """Horizontal momentum relative to the trolley, kg m/s."""

    def released_force(self, motion: Motion, trolley_v: float) -> float:
        """Force of the drive, N, in the instant of release."""

    def posture(self, motion: Motion) -> Posture:
        """Positions and velocities, relative to the trolley."""
