"""What both cranes share: the commands, the trolley, the energy ledger, the outputs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from math import atan2, ceil

import numpy as np

from .chain import Array, DiscreteChain, discretise, interpolation
from .errors import BadState
from .ledger import Effort, Ledger
from .parameters import MATERIAL_POINTS, Crane, Initial, Numerics, check
from .trolley import Trolley, checked_move


@dataclass(frozen=True)
class Posture:
    """What is seen of a crane, relative to its trolley."""

    points: Array  # m, (11, 2): ten material points from the top, then the middle of the chain
    payload: Array  # m, (2,)
    payload_w: Array  # m/s, (2,)
    top_angle: float  # rad
    trolley_fx: float  # N
    tension_top: float  # N
    tension_min: float  # N


class CraneModel(ABC):
    """A crane that is driven by commands that are held over each communication step."""

    def __init__(
        self,
        crane: Crane | None = None,
        initial: Initial | None = None,
        numerics: Numerics | None = None,
    ) -> None:
        self.crane = crane or Crane()
        self.initial = initial or Initial()
        self.numerics = numerics or Numerics()
        check(self.crane, self.initial, self.numerics)
        self.chain: DiscreteChain = discretise(
            self.crane, self.numerics.elements, self.numerics.mass_matrix
        )
        self.start_time = self.time = 0.0
        self.trolley = Trolley(v=self.initial.speed)
        self.effort = Effort()
        fractions = np.append(np.arange(1, MATERIAL_POINTS + 1) / MATERIAL_POINTS, 0.5)
        self._interpolation = interpolation(self.numerics.elements, fractions)

    def step(
        self, h: float, v_cmd: float = 0.0, a_cmd: float = 0.0, payload_fx: float = 0.0
    ) -> None:
        """Advance by ``h`` seconds under held commands: m/s, m/s2, and N on the payload.

        A v_cmd that differs from the trolley's velocity is a jump: an impulse at the step's start.
        Raises BadValue for a value that is not allowed, NotConverged or EnergyBalanceBroken where
        the motion cannot be had; the crane is then as it was before the call.
        """
        after = checked_move(self.trolley, self.numerics.max_step, h, v_cmd, a_cmd, payload_fx)
        start = replace(self.trolley, v=self.trolley.commanded(v_cmd))
        self._advance(h, start, a_cmd, payload_fx)
        self.trolley = after
        self.time += h

    def internal_steps(self, h: float) -> int:
        """Number of equal internal steps for a communication step of ``h`` seconds.

        A ratio that is whole but for round-off, 13 ms over 1 ms, counts as whole.
        """
        return max(1, ceil(h / self.numerics.max_step * (1.0 - 1e-9)))

    @abstractmethod
    def _advance(self, h: float, start: Trolley, a_cmd: float, payload_fx: float) -> None:
        """Advance the chain by ``h``; all or nothing. ``start``: the trolley after its jump."""

    @property
    @abstractmethod
    def energy(self) -> float:
        """Mechanical energy above the rest position, J."""

    @property
    @abstractmethod
    def ledger(self) -> Ledger:
        """The energy ledger."""

    @abstractmethod
    def _save(self) -> Array:
        """The model's own state as one vector."""

    @abstractmethod
    def _load(self, vector: Array) -> None:
        """Restore what :meth:`_save` gave."""

    def save(self) -> bytes:
        """The whole state, bit for bit; the parameters are not in it."""
        shared = [self.time, self.trolley.x, self.trolley.v, self.trolley.gained]
        shared += [float(self.effort.steps), float(self.effort.iterations)]
        return np.concatenate((shared, self._save())).astype("<f8").tobytes()

    def load(self, state: bytes) -> None:
        """Restore what :meth:`save` gave, in a crane with the same parameters.

        Raises BadState, the crane unchanged, where the size does not fit.
        """
        if len(state) != len(self.save()):
            raise BadState("the saved state is of a crane with another number of elements")
        vector = np.frombuffer(state, dtype="<f8").astype(float)
        self.time = float(vector[0])
        self.trolley = Trolley(*vector[1:4].tolist())
        self.effort = Effort(int(vector[4]), int(vector[5]))
        self._load(vector[6:])

    @abstractmethod
    def _posture(self) -> Posture:
        """Positions and forces, relative to the trolley."""

    def output_values(self) -> list[float]:
        """All outputs in the interface's order, in SI units."""
        return list(self.outputs().values())

    def outputs(self) -> dict[str, float]:
        """All outputs by their FMU names, in SI units, in the interface's order."""
        posture, trolley, ledger = self._posture(), self.trolley, self.ledger
        x_rel, y_rel = float(posture.payload[0]), float(posture.payload[1])
        energy = self.energy
        values = {
            "trolley.x": trolley.x,
            "trolley.v": trolley.v,
            "trolley.fx": posture.trolley_fx,
            "payload.x": trolley.x + x_rel,
            "payload.y": y_rel,
            "payload.vx": trolley.v + float(posture.payload_w[0]),
            "payload.vy": float(posture.payload_w[1]),
            "payload.x_rel": x_rel,
            "payload.sway_angle": atan2(x_rel, -y_rel),
            "chain.mid_x_rel": float(posture.points[-1, 0]),
            "chain.top_angle": posture.top_angle,
            "chain.tension_top": posture.tension_top,
            "chain.tension_min": posture.tension_min,
        }
        points = posture.points[:MATERIAL_POINTS].tolist()
        for i, (x, _) in enumerate(points, start=1):
            values[f"chain.x[{i}]"] = trolley.x + x
        for i, (_, y) in enumerate(points, start=1):
            values[f"chain.y[{i}]"] = y
        values["energy.total"] = energy
        values["energy.dissipated"] = ledger.dissipated
        values["energy.error"] = energy - ledger.expected
        values["solver.steps"] = self.effort.steps
        values["solver.iterations"] = self.effort.iterations
        return values
