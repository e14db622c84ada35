"""What both cranes share: the commands, the trolley, the energy ledger, the outputs."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection
from dataclasses import asdict, dataclass, fields
from math import atan2
from operator import itemgetter

import numpy as np

from ..errors import BadState
from ..whole_step import WholeSteps
from .chain import Array, DiscreteChain, discretise
from .command import IDLE, Command
from .interface import MATERIAL_POINTS, OUTPUTS, SHARED_STATE
from .ledger import Effort, Ledger
from .parameters import Crane, Initial, Numerics, check
from .trolley import Trolley, checked_move, equal_parts

_NAMES = tuple(variable.name for variable in OUTPUTS)
_ORDERED = itemgetter(*_NAMES)  # of outputs by name
_X, _Y = ([f"chain.{axis}[{i}]" for i in range(1, MATERIAL_POINTS + 1)] for axis in "xy")


def material_fractions() -> Array:
    """Fractions of the chain's length of the points that are seen: ten, then the middle, (11,)."""
    return np.append(np.arange(1, MATERIAL_POINTS + 1) / MATERIAL_POINTS, 0.5)


@dataclass(frozen=True)
class Posture:
    """What is seen of a crane, relative to its trolley."""

    points: Array  # m, (11, 2): ten material points from the top, then the middle of the chain
    node1: Array  # m, (2,), from the trolley along the chain's top: its first node, say
    payload: Array  # m, (2,)
    payload_w: Array  # m/s, (2,)


@dataclass(frozen=True)
class Solution:
    """What a model keeps of a solution, as a saved state has it."""

    numbers: dict[str, float]  # its own, by the names of the state's table
    arrays: Array
    ledger: Ledger


class CraneModel(WholeSteps):
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
        self.impulse = 0.0  # N s, of the jump at the last communication step's start

    def step(self, h: float, command: Command = IDLE) -> None:
        """Advance by ``h`` seconds under a held command.

        A v_cmd that differs from the trolley's velocity is a jump: an impulse at the step's start.
        Raises BadValue for a value that is not allowed, NotConverged or EnergyBalanceBroken where
        the motion cannot be had; the crane is then as it was before the call.
        """
        after = checked_move(self.trolley, self.numerics.max_step, h, command)
        before = self.trolley
        start = Trolley(before.x, before.commanded(command), before.gained)
        self._advance(h, start, command)
        self.trolley = after
        self.time += h

    def internal_steps(self, h: float) -> int:
        """Number of equal internal steps for a communication step of ``h`` seconds."""
        return equal_parts(h, self.numerics.max_step)

    @abstractmethod
    def _advance(self, h: float, start: Trolley, command: Command) -> None:
        """Advance the chain by ``h``; all or nothing. ``start``: the trolley after its jump."""

    @property
    @abstractmethod
    def energy(self) -> float:
        """Mechanical energy above the rest position, J."""

    @property
    @abstractmethod
    def ledger(self) -> Ledger:
        """The energy ledger."""

    @property
    @abstractmethod
    def error_payload(self) -> float:
        """Estimated time error of the payload's place, m, the largest since the start."""

    @property
    @abstractmethod
    def _state_names(self) -> Collection[str]:
        """Names of the numbers that the state begins with: a table of interface.py."""

    @abstractmethod
    def _save(self) -> list[Solution]:
        """The model's own state: its solution, and one that it carries along, if it does."""

    @abstractmethod
    def _load(self, solutions: list[Solution]) -> None:
        """Restore what :meth:`_save` gave."""

    def save(self) -> bytes:
        """The whole state, bit for bit; the parameters are not in it."""
        vectors = [self._vector(solution) for solution in self._save()]
        return np.concatenate(vectors).astype("<f8").tobytes()

    def _vector(self, solution: Solution) -> Array:
        trolley, effort = self.trolley, self.effort
        numbers = {
            "time": self.time,
            "trolley_x": trolley.x,
            "trolley_v": trolley.v,
            "trolley_gained": trolley.gained,
            "steps": float(effort.steps),
            "iterations": float(effort.iterations),
            "trolley_impulse": self.impulse,
            **{f"ledger_{name}": value for name, value in asdict(solution.ledger).items()},
            **solution.numbers,
        }
        ordered = [numbers.pop(name) for name in self._state_names]
        assert not numbers, f"not in the table of the state: {sorted(numbers)}"
        return np.concatenate((ordered, solution.arrays))

    def load(self, state: bytes) -> None:
        """Restore what :meth:`save` gave, in a crane with the same parameters.

        Raises BadState, the crane unchanged, where the size does not fit.
        """
        if len(state) != len(self.save()):
            raise BadState.of_other_settings()
        vectors = np.split(np.frombuffer(state, dtype="<f8").astype(float), len(self._save()))
        names = self._state_names
        numbers = dict(zip(names, vectors[0][: len(names)].tolist(), strict=True))
        self.time = numbers["time"]
        self.trolley = Trolley(
            numbers["trolley_x"], numbers["trolley_v"], numbers["trolley_gained"]
        )
        self.effort = Effort(int(numbers["steps"]), int(numbers["iterations"]))
        self.impulse = numbers["trolley_impulse"]
        self._load([self._solution(vector) for vector in vectors])

    def _solution(self, vector: Array) -> Solution:
        names = self._state_names
        numbers = dict(zip(names, vector[: len(names)].tolist(), strict=True))
        ledger = Ledger(**{f.name: numbers[f"ledger_{f.name}"] for f in fields(Ledger)})
        own = {name: value for name, value in numbers.items() if name not in SHARED_STATE}
        return Solution(own, vector[len(names) :], ledger)

    @abstractmethod
    def _posture(self) -> Posture:
        """Positions and velocities, relative to the trolley."""

    @abstractmethod
    def _own_outputs(self) -> dict[str, float]:
        """Outputs that each model has in its own way, by their FMU names, in SI units."""

    def notice(self) -> str | None:
        """What a user should be told of the motion, once; None: nothing."""
        return None

    def outputs(self) -> dict[str, float]:
        """All outputs by their FMU names, in SI units, in the interface's order."""
        return dict(zip(_NAMES, self.output_values(), strict=True))

    def output_values(self) -> list[float]:
        """All outputs in the interface's order, in SI units."""
        posture, trolley, ledger = self._posture(), self.trolley, self.ledger
        points = posture.points.tolist()
        middle = points.pop()
        x_rel, y_rel = posture.payload.tolist()
        vx_rel, vy = posture.payload_w.tolist()
        top_x, top_y = posture.node1.tolist()
        energy = self.energy
        values = {
            "trolley.x": trolley.x,
            "trolley.v": trolley.v,
            "trolley.impulse": self.impulse,
            "payload.x": trolley.x + x_rel,
            "payload.y": y_rel,
            "payload.vx": trolley.v + vx_rel,
            "payload.vy": vy,
            "payload.x_rel": x_rel,
            "payload.sway_angle": atan2(x_rel, -y_rel),
            "chain.mid_x_rel": middle[0],
            "chain.top_angle": atan2(top_x, -top_y),
            "energy.total": energy,
            "energy.dissipated": ledger.dissipated,
            "energy.error": energy - ledger.expected,
            "solver.steps": self.effort.steps,
            "solver.iterations": self.effort.iterations,
            **self._own_outputs(),
        }
        values.update(zip(_X, [trolley.x + x for x, _ in points], strict=True))
        values.update(zip(_Y, [y for _, y in points], strict=True))
        assert len(values) == len(_NAMES), f"not in the table of outputs, one of: {list(values)}"
        return list(_ORDERED(values))
