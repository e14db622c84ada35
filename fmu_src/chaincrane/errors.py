"""What can go wrong in a crane model, each as one clear sentence."""

from __future__ import annotations


class CraneError(Exception):
    """Base of every error that a crane model raises on purpose."""


class BadValue(CraneError):
    """A parameter, an input or a step size that is not allowed.

    The message names the variable as the FMU does, its value and what is allowed.
    """

    def __init__(self, name: str, value: object, allowed: str) -> None:
        super().__init__(f"{name} = {value!r} is not allowed: {allowed}")
        self.name = name
        self.value = value
        self.allowed = allowed


class NotConverged(CraneError):
    """The iteration for dynamic equilibrium did not converge in a step."""


class EnergyBalanceBroken(CraneError):
    """A step converged, but energy appeared from or vanished into nothing."""


class BadState(CraneError):
    """A saved state that is damaged, or belongs to another model or build."""
