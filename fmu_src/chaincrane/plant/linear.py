"""The linear crane: a taut string with a point mass, the paper's section 2.2.

Horizontal displacement only, relative to the trolley: K 1 = 0, so the rigid translation drops out
of the stiffness and the trolley acts through its acceleration. Tensions are those of the hanging
equilibrium. With commands held over a step the motion is known in closed form; there is no time
step to choose. Axial damping (damping.chain) has no place here: the string keeps its length.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .chain import (
    Array,
    DiscreteChain,
    carried_force,
    discretise,
    hanging_tension,
    interpolation,
    mass_times,
    payload_work,
)
from .command import IDLE, Command
from .crane import CraneModel, Posture, Solution, material_fractions
from .interface import LINEAR_STATE, MATERIAL_POINTS
from .ledger import Effort, Ledger
from .parameters import Crane, Initial, Numerics
from .trolley import Trolley, equal_parts

DRAG_PANEL = 1e-3  # s; four Gauss points carry modes up to some 2000 rad/s
CRITICAL = 1e-5  # |kappa t| below which damping counts as critical
GAUSS_NODES = (-0.86113631159405257, -0.33998104358485626, 0.33998104358485626, 0.86113631159405257)
GAUSS_WEIGHTS = (0.34785484513745385, 0.65214515486254614, 0.65214515486254614, 0.34785484513745385)
_DRAG_BLOCK = 256  # panels at once


def element_stiffness(tension: float, L0: float) -> Array:
    """Stiffness of a taut string element, (30): N_e/L0 [1 -1; -1 1], N/m (signs lost in print)."""
    return tension / L0 * np.array([[1.0, -1.0], [-1.0, 1.0]])


def stiffness_matrix(chain: DiscreteChain) -> Array:
    """K of (31) for the free nodes, N/m, shape (n, n)."""
    tension = hanging_tension(chain.crane, chain.elements)
    K = np.zeros((chain.elements + 1, chain.elements + 1))
    for e in range(chain.elements):
        K[e : e + 2, e : e + 2] += element_stiffness(float(tension[e]), chain.L0)
    return K[1:, 1:]


def mass_matrix(chain: DiscreteChain) -> Array:
    """M of (31) for the free nodes, kg, shape (n, n), the payload at the last one, (30)."""
    coupling = np.full(chain.elements - 1, chain.mass_coupling)
    return np.diag(chain.mass_diagonal) + np.diag(coupling, 1) + np.diag(coupling, -1)


@dataclass(frozen=True)
class Modes:
    """Undamped modes of the string: K phi = omega^2 M phi, phi^T M phi = 1."""

    omega: Array  # rad/s, (n,), ascending
    shapes: Array  # 1/sqrt(kg), (n, n), a column a mode

    @cached_property
    def squares(self) -> Array:
        """omega^2, rad2/s2, (n,)."""
        squares: Array = self.omega**2
        return squares


def modes(chain: DiscreteChain) -> Modes:
    """Frequencies and shapes of the string with its payload; O(n^3), once."""
    lower = np.linalg.cholesky(mass_matrix(chain))
    inner = np.linalg.solve(lower, np.linalg.solve(lower, stiffness_matrix(chain)).T)
    squares, vectors = np.linalg.eigh(0.5 * (inner + inner.T))
    return Modes(np.sqrt(squares), np.linalg.solve(lower.T, vectors))


@dataclass(frozen=True)
class StateSpace:
    """xdot = A x + B u, y = C x + D u, (32), with its names; SI units.

    States: relative displacements q1..qn and their rates. Inputs: trolley.a_cmd and payload.fx.
    Outputs: payload.x_rel, chain.mid_x_rel, chain.top_angle (as a slope). The air's damping acts on
    the velocity relative to the trolley here: a state space with its input has no trolley velocity.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


def state_space(crane: Crane, elements: int, mass_kind: str = "consistent") -> StateSpace:
    """The paper's state space (32) for control design; pass A, B, C, D on to python-control."""
    chain = discretise(crane, elements, mass_kind)
    n = elements
    M, K = mass_matrix(chain), stiffness_matrix(chain)
    A = np.zeros((2 * n, 2 * n))
    A[:n, n:] = np.eye(n)
    A[n:, :n] = -np.linalg.solve(M, K)
    A[n:, n:] = -crane.damping.air * np.eye(n)
    load = np.zeros((n, 2))
    load[:, 0] = -chain.row_mass
    load[-1, 1] = 1.0
    B = np.vstack((np.zeros((n, 2)), np.linalg.solve(M, load)))
    C = np.zeros((3, 2 * n))
    C[0, n - 1] = 1.0
    C[1, :n] = interpolation(n, np.array([0.5]))[0]
    C[2, 0] = 1.0 / chain.L0
    return StateSpace(
        A,
        B,
        C,
        np.zeros((3, 2)),
        tuple(f"q[{i}]" for i in range(1, n + 1)) + tuple(f"qdot[{i}]" for i in range(1, n + 1)),
        ("trolley.a_cmd", "payload.fx"),
        ("payload.x_rel", "chain.mid_x_rel", "chain.top_angle"),
    )


@dataclass(frozen=True)
class ModalMotion:
    """Modal coordinates and rates: q = shapes eta."""

    eta: Array  # m sqrt(kg), (n,)
    rate: Array  # m sqrt(kg)/s, (n,)


def free_response(omega: Array, air: float, t: float | Array) -> tuple[Array, Array]:
    """Response of each mode after ``t`` s to a unit rate at 0, and the derivative of it.

    s(t) = exp(-alpha t/2) sinh(kappa t)/kappa, kappa = sqrt(alpha^2/4 - omega^2): an oscillation
    where kappa is imaginary, a creep where the air's damping is more than critical.
    """
    kappa = np.sqrt(0.25 * air * air - omega * omega + 0j)
    slow, fast = np.exp((kappa - 0.5 * air) * t), np.exp((-kappa - 0.5 * air) * t)
    near = np.abs(kappa * t) < CRITICAL  # critical damping: the quotient's limit
    with np.errstate(divide="ignore", invalid="ignore"):
        s = np.where(near, t * np.exp(-0.5 * air * t), (slow - fast) / (2.0 * kappa))
    s = s.real
    return s, (0.5 * (slow + fast)).real - 0.5 * air * s


class TautString:
    """The string with its payload in modal coordinates: what moves it, and how it moves."""

    def __init__(self, chain: DiscreteChain) -> None:
        self.modes = modes(chain)
        self.push = self.modes.shapes.T @ chain.row_mass  # sqrt(kg), load of 1 m/s2 of braking
        self.air = chain.crane.damping.air  # 1/s
        self._response = (0.0, self.push, self.push)  # of the last length of step

    def response(self, t: float) -> tuple[Array, Array]:
        """:func:`free_response` of the modes after ``t`` s."""
        if self._response[0] != t:
            self._response = t, *free_response(self.modes.omega, self.air, t)
        return self._response[1:]

    def jump(self, motion: ModalMotion, dv: float) -> ModalMotion:
        """The trolley's velocity jumps by ``dv`` m/s: an impulse -b dv on the free nodes."""
        return ModalMotion(motion.eta, motion.rate - self.push * dv)

    def forcing(self, v: float, command: Command) -> tuple[Array, Array]:
        """Modal load p0 + p1 t of a trolley at v + a t in air, and of the payload's force."""
        a = command.trolley_a_cmd
        p0 = -self.push * (a + self.air * v) + self.modes.shapes[-1] * command.payload_fx
        return p0, -self.push * (self.air * a)

    def propagate(
        self, motion: ModalMotion, t: float | Array, v: float, command: Command
    ) -> ModalMotion:
        """Exact motion after ``t`` s; ``v``: the trolley's velocity at its start, m/s.

        Times may be a column (k, 1): the motion is then (k, n).
        """
        return self.moved(motion, t, *self.forcing(v, command))

    def moved(self, motion: ModalMotion, t: float | Array, p0: Array, p1: Array) -> ModalMotion:
        """Motion after ``t`` s of a load: the matrix exponential of (32), a 2x2 block a mode.

        eta'' + alpha eta' + omega^2 eta = p0 + p1 t has the particular solution c0 + c1 t.
        """
        squares = self.modes.squares
        c1 = p1 / squares
        c0 = (p0 - self.air * c1) / squares
        if isinstance(t, float):
            s, s_dot = self.response(t)
        else:
            s, s_dot = free_response(self.modes.omega, self.air, t)
        eta, rate = motion.eta - c0, motion.rate - c1
        return ModalMotion(
            (s_dot + self.air * s) * eta + s * rate + c0 + c1 * t,
            s_dot * rate - squares * s * eta + c1,
        )


class LinearCrane(CraneModel):
    """The paper's linear crane, any number of elements, stepped exactly."""

    def __init__(
        self,
        crane: Crane | None = None,
        initial: Initial | None = None,
        numerics: Numerics | None = None,
    ) -> None:
        super().__init__(crane, initial, numerics)
        chain = self.chain
        self.string = TautString(chain)
        self.modes = self.string.modes
        self._tension = hanging_tension(self.crane, chain.elements)
        self._interpolation = interpolation(chain.elements, material_fractions())
        self._seen = np.vstack((self._interpolation, np.eye(1, chain.elements)))
        self._seen = self._seen @ self.modes.shapes  # 11 material points, node 1
        self._hanging = np.zeros((len(self._interpolation), 2))  # m, material points at rest
        self._hanging[:, 1] = self._interpolation @ chain.rest[:, 1]
        self._ends = self.modes.shapes[[0, -1]]  # node 1, payload
        depth = chain.L0 * np.arange(1, chain.elements + 1)
        straight = mass_times(chain, np.outer(depth, [np.sin(self.initial.sway_angle), 0.0]))[:, 0]
        eta = self.modes.shapes.T @ straight
        self._motion = ModalMotion(eta, np.zeros_like(eta))
        p0, _ = self.string.forcing(self.trolley.v, IDLE)
        self._rate_of_rate = p0 - self.modes.squares * eta
        self._trolley_fx = self._drive_force(self.trolley.v, IDLE)
        self._ledger = Ledger(start=self._energy(self._motion, self.trolley.v))

    @property
    def error_payload(self) -> float:
        """Estimated time error of the payload's place, m: none, each step is exact."""
        return 0.0

    @property
    def energy(self) -> float:
        """Mechanical energy above the rest position, J."""
        return self._energy(self._motion, self.trolley.v)

    @property
    def ledger(self) -> Ledger:
        """The energy ledger."""
        return self._ledger

    def _energy(self, motion: ModalMotion, trolley_v: float) -> float:
        """1/2 v^T M v + 1/2 q^T K q, J, with absolute velocities v, in modal coordinates."""
        relative = 0.5 * float(motion.rate @ motion.rate)
        elastic = 0.5 * float(((self.modes.omega * motion.eta) ** 2).sum())
        return relative + elastic + self._carried(motion, trolley_v)

    def _carried(self, motion: ModalMotion, trolley_v: float) -> float:
        """Kinetic energy, J, that the trolley's velocity adds to the relative motion's."""
        total = self.crane.total_mass
        return (
            trolley_v * float(self.string.push @ motion.rate) + 0.5 * total * trolley_v * trolley_v
        )

    def _advance(self, h: float, start: Trolley, command: Command) -> None:
        before, a_cmd = self._motion, command.trolley_a_cmd
        dv = start.v - self.trolley.v
        jumped = self.string.jump(before, dv)
        p0, p1 = self.string.forcing(start.v, command)
        after = self.string.moved(jumped, h, p0, p1)
        end_v = start.v + h * a_cmd
        trolley_dx = h * (start.v + 0.5 * h * a_cmd)
        moved = self.modes.shapes[-1:] @ (after.eta - before.eta)
        work_payload = payload_work(command, moved, trolley_dx)
        dissipated, drag_work = self._drag(jumped, h, start.v, command)
        # The drive gives all change of horizontal momentum P that the payload's force and the air
        # do not: with v = v0 + a t its work is the integral of (P' - fx + drag) v.
        begun = self._momentum(jumped, start.v)
        drive_work = (
            self._momentum(after, end_v) * end_v
            - begun * start.v
            - a_cmd * self._carried_path(jumped, after, trolley_dx)
            - command.payload_fx * trolley_dx
            + drag_work
        )
        impulse = begun - self._momentum(before, self.trolley.v)
        jump_work = 0.5 * (start.v + self.trolley.v) * impulse
        self._motion = after
        self._rate_of_rate = (
            p0 + h * p1 - self.crane.damping.air * after.rate - self.modes.squares * after.eta
        )
        self._trolley_fx = self._drive_force(end_v, command)
        self.impulse = impulse
        self._ledger = self._ledger.booked(jump_work + drive_work, work_payload, dissipated)
        self.effort = Effort(steps=1, iterations=0)

    def _momentum(self, motion: ModalMotion, trolley_v: float) -> float:
        """Horizontal momentum of chain and payload, kg m/s."""
        total = self.crane.total_mass
        return float(self.string.push @ motion.rate) + total * trolley_v

    def _carried_path(self, start: ModalMotion, end: ModalMotion, trolley_dx: float) -> float:
        """Integral of the momentum over a step, kg m: mass times absolute displacement."""
        total = self.crane.total_mass
        return float(self.string.push @ (end.eta - start.eta)) + total * trolley_dx

    def _drag(
        self, motion: ModalMotion, h: float, v: float, command: Command
    ) -> tuple[float, float]:
        """What the air takes in a step, alpha v^T M v, and the drive's work against its drag, J.

        Gauss quadrature of the exact motion, four points to each panel of at most DRAG_PANEL.
        """
        air = self.crane.damping.air
        taken = work = 0.0
        if not air:
            return taken, work
        total = self.crane.total_mass
        count = equal_parts(h, DRAG_PANEL)
        width = h / count
        places = 0.5 * (1.0 + np.array(GAUSS_NODES)) * width
        for first in range(0, count, _DRAG_BLOCK):
            panels = np.arange(first, min(first + _DRAG_BLOCK, count))
            t = np.add.outer(panels * width, places).ravel()
            weights = np.tile(0.5 * width * np.array(GAUSS_WEIGHTS), len(panels))
            rate = self.string.propagate(motion, t[:, None], v, command).rate
            trolley_v = v + command.trolley_a_cmd * t
            relative = rate @ self.string.push  # momentum of the relative motion, kg m/s
            twice_kinetic = np.einsum("ij,ij->i", rate, rate) + trolley_v * (
                2.0 * relative + total * trolley_v
            )
            taken += air * float(weights @ twice_kinetic)
            work += air * float(weights @ (trolley_v * (relative + total * trolley_v)))
        return taken, work

    def _drive_force(self, trolley_v: float, command: Command) -> float:
        """Force of the drive on the chain, N: node 0's row of (31)."""
        ends = self._ends
        q = float(ends[0] @ self._motion.eta)
        inertia = ends @ self._rate_of_rate + self.crane.damping.air * (ends @ self._motion.rate)
        carried = carried_force(self.chain, command, trolley_v, *inertia.tolist())
        return carried - float(self._tension[0]) / self.chain.L0 * q

    @property
    def _state_names(self) -> Collection[str]:
        return LINEAR_STATE

    def _save(self) -> list[Solution]:
        motion = self._motion
        arrays = np.concatenate((motion.eta, motion.rate, self._rate_of_rate))
        return [Solution({"trolley_fx": self._trolley_fx}, arrays, self._ledger)]

    def _load(self, solutions: list[Solution]) -> None:
        (solution,) = solutions
        self._ledger, self._trolley_fx = solution.ledger, solution.numbers["trolley_fx"]
        eta, rate, self._rate_of_rate = np.split(solution.arrays, 3)
        self._motion = ModalMotion(eta, rate)

    def _posture(self) -> Posture:
        """The string's displacements at the rest position's depths."""
        rest = self.chain.rest[:, 1]
        seen = self._seen @ self._motion.eta
        points = self._hanging.copy()
        points[:, 0] = seen[:-1]
        return Posture(
            points,
            node1=np.array((seen[-1], rest[0])),
            payload=np.array((seen[MATERIAL_POINTS - 1], rest[-1])),
            payload_w=np.array((self.modes.shapes[-1] @ self._motion.rate, 0.0)),
        )

    def _own_outputs(self) -> dict[str, float]:
        return {
            "trolley.fx": self._trolley_fx,
            "chain.tension_top": float(self._tension[0]),
            "chain.tension_min": float(self._tension[-1]),
            "chain.slack_time": 0.0,
            "error.payload": self.error_payload,
            "error.tension_top": 0.0,
            "error.trolley_fx": 0.0,
            "error.predictable": 1,
        }
