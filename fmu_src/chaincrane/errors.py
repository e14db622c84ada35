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

    iterations = 0  # spent in vain

    @classmethod
    def in_step(cls, h: float, iterations: int = 0) -> NotConverged:
        """The error of a step of ``h`` seconds."""
        error = cls(
            f"the iteration for dynamic equilibrium did not converge in a step of {h:.3g} s"
        )
        error.iterations = iterations
        return error

    @classmethod
    def singular(cls, h: float) -> NotConverged:
        """The error of a step of ``h`` seconds whose effective stiffness cannot be factored."""
        return cls(f"the effective stiffness is singular in a step of {h:.3g} s")


class EnergyBalanceBroken(CraneError):
    """A step converged, but energy appeared from or vanished into nothing."""

    iterations = 0  # spent in vain

    @classmethod
    def in_step(cls, h: float, off: float, scale: float, allowed: float) -> EnergyBalanceBroken:
        """A step of ``h`` seconds is off by ``off`` J, where ``allowed`` of ``scale`` J may be."""
        return cls(
            f"a step of {h:.3g} s is off its energy balance by {off:.3g} J"
            f" of {scale:.3g} J; allowed is {allowed:g} of it"
        )

    @classmethod
    def since_start(cls, off: float, scale: float, allowed: float) -> EnergyBalanceBroken:
        """The balance since the start is off by ``off`` J, see :meth:`in_step`."""
        return cls(
            f"the energy balance since the start is off by {off:.3g} J"
            f" of {scale:.3g} J; allowed is {allowed:g} of it"
        )


class BadState(CraneError):
    """A saved state that is damaged, or belongs to another model or build."""

    @classmethod
    def of_other_settings(cls) -> BadState:
        """The error of a state whose size does not fit."""
        return cls(
            "the saved state is of other chain.elements, solver.error_estimate or solver.tolerance"
        )
