"""What a communication step leaves besides the motion: the energy ledger and its cost."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Ledger:
    """Energy that went in and out since the start, J."""

    start: float = 0.0
    trolley: float = 0.0
    payload: float = 0.0
    dissipated: float = 0.0

    def booked(self, trolley: float, payload: float, dissipated: float) -> Ledger:
        """The ledger after one more step."""
        return Ledger(
            self.start,
            self.trolley + trolley,
            self.payload + payload,
            self.dissipated + dissipated,
        )

    @property
    def expected(self) -> float:
        """Mechanical energy that must be there now."""
        return self.start + self.trolley + self.payload - self.dissipated


@dataclass(frozen=True)
class Effort:
    """Cost of the last communication step."""

    steps: int = 0
    iterations: int = 0
