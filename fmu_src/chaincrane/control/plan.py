"""A plan: accelerations that bring payload and trolley to rest at the target, within limits.

The trolley's acceleration is held over cells of dt s. What the cells do to trolley and modes at any
later instant is linear in them, so that a plan is a linear program (da Cruz & Leonardi 2013), which
scipy.optimize.linprog hands to HiGHS:

- by bisection the fewest cells N from whose end on the payload stays within a tolerance of its
  target, all planned modes and the trolley being at rest half a period of mode 1 later;
- then, with a share more time, the least sway that ROBUST modes keep where frequencies are wrong by
  SPREAD, and with little weight the least jerk.

A long move is a ramp to its cruise and one to rest, planned alike: over the whole of it a residual
would turn with frequency too fast to be made robust.

Units of the program: A for accelerations, 1/omega_1 for times, A/omega_1^2 for lengths.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, floor, inf, pi, sqrt
from typing import Any

import numpy as np
import scipy.sparse as sparse
from scipy.optimize import linprog

from ..plant.chain import Array
from .move import Limits, Move, from_cells, joined
from .regulator import discretised

CELLS_PER_PERIOD = 50  # of mode 1
MOST_CELLS = 400
MORE_CELLS = (0, 4, 12, 28, 60)  # beyond what it is given, that a plan may take to keep its jerk
LONG = 2.5  # periods of mode 1 of cruise: a longer move is planned ramp by ramp
TAIL = 0.5  # periods of mode 1 from settling to rest
SETTLING = 0.08  # periods of mode 1 that settling takes longer than the trolley alone, about
ROBUST = 3  # modes
WAVES = 4.0  # weight of the sway left in those beyond the first, which feedback damps slowly
SPREAD = 0.05  # of each frequency: a length wrong by a tenth
JERK_WEIGHT = 0.02  # of a jerk of A omega_1 beside a sway of A/omega_1^2
AT_REST = 1e-9  # of A/omega_1^2 and its rates: as good as at rest
TIGHT = 0.05  # of the distance: what the tolerance is at most
# Of HiGHS. A presolve takes longer than it saves; but where the drive lags, some programs are left
# open without one.
_QUICK = {"presolve": False, "simplex_dual_edge_weight_strategy": "devex"}
_THOROUGH = _QUICK | {"presolve": True}
_ANSWERS = (0, 2)  # linprog's status: solved, there is no solution
_DIGITS = 9  # of a start's units: below, hosts' clocks differ
_KEPT = 64  # moves from rest, of all cranes of a process


class NoPlan(Exception):
    """There is no plan; the message says why."""


@dataclass(frozen=True)
class Margins:
    """What a plan leaves free."""

    velocity: float = 0.98  # of the limit; the rest is the regulator's
    acceleration: float = 0.97
    spare: float = 0.09  # of the shortest time to settle, given for robustness
    jerk: float = 4.0  # A omega_1, from the command that a plan finds to its first, and on


FULL = Margins(1.0 - 1e-6, 1.0 - 1e-6, 0.0, inf)  # less the solver's tolerance


@dataclass(frozen=True)
class Start:
    """Where a plan begins."""

    x: Array  # state of the model, the position relative to the target
    a: float  # m/s2, commanded


@dataclass(frozen=True, eq=False)
class Model:
    """What is planned for: :func:`regulator.design_model`'s matrices and its modes.

    Two are equal where all their bits are.
    """

    A: Array
    B: Array
    omega: Array  # rad/s, of the planned modes
    lag: float  # s, of the drive

    def _bits(self) -> tuple[bytes, bytes, bytes, float]:
        return self.A.tobytes(), self.B.tobytes(), self.omega.tobytes(), self.lag

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Model) and self._bits() == other._bits()

    def __hash__(self) -> int:
        return hash(self._bits())

    def commanded(self, x: Array) -> float:
        """Velocity, m/s, that the commands have added up to where the state is ``x``.

        v_cmd = v + lag a, as lag a' = a_cmd - a.
        """
        return float(x[1] + self.lag * x[-1]) if self.lag else float(x[1])

    @property
    def period(self) -> float:
        """Of mode 1, s."""
        return 2.0 * pi / float(self.omega[0])

    def off(self, factor: float) -> Array:
        """A with all frequencies times ``factor``."""
        A = self.A.copy()
        for mode in range(len(self.omega)):
            A[3 + 2 * mode, 2 + 2 * mode] *= factor**2
        return A


def plan(
    model: Model, start: Start, limits: Limits, tolerance: float, margins: Margins, h: float
) -> Move:
    """A move from ``start`` to rest at the target; its cells are whole steps of ``h`` s.

    Raises NoPlan where there is none.
    """
    scale = _Scale(model, limits)
    x = start.x / scale.state
    still = np.abs(np.append(x[1:], start.a / scale.a)) < AT_REST
    if still.all():
        return _from_rest(model, -float(start.x[0]), limits, tolerance, margins, h)
    rounded = np.round(x, _DIGITS) * scale.state
    near = Start(rounded, start.a)
    return _planned(model, near, limits, tolerance, margins, h)


def _from_rest(
    model: Model, distance: float, limits: Limits, tolerance: float, margins: Margins, h: float
) -> Move:
    """From rest a move and its mirror image are one, and a short one is a longer one scaled."""
    least = max(abs(distance), 0.1 * tolerance)
    move = forwards(model, least, limits, min(tolerance, TIGHT * least), margins, h)
    return move.scaled(distance / least)


@lru_cache(_KEPT)
def forwards(
    model: Model, distance: float, limits: Limits, tolerance: float, margins: Margins, h: float
) -> Move:
    """The move from rest to rest ``distance`` m ahead, kept: the same is asked for again."""
    x = np.zeros(len(model.A))
    x[0] = -distance
    move = _planned(model, Start(x, 0.0), limits, tolerance, margins, h)
    v, gone = 0.0, 0.0
    for begin, end, a in zip(move.times, move.times[1:], move.a, strict=False):
        gone += (end - begin) * (v + 0.5 * a * (end - begin))
        v += a * (end - begin)
    exact = distance / gone  # what the solver's tolerance has left open
    return move.scaled(min(exact, 1.0 + 1e-6))


def _planned(
    model: Model, start: Start, limits: Limits, tolerance: float, margins: Margins, h: float
) -> Move:
    V, A = margins.velocity * limits.velocity, margins.acceleration * limits.acceleration
    length = abs(float(start.x[0]))
    dt = h * max(1, floor(model.period / CELLS_PER_PERIOD / h * (1.0 + 1e-9)))
    if length > LONG * model.period * V:
        move = _ramped(_Program(model, start, limits, margins, dt), start, V, margins)
        if move is not None:
            return move
    fastest = length / V + V / A if length > V * V / A else 2.0 * sqrt(length / A)
    dt *= max(1, ceil(fastest / dt / (0.5 * MOST_CELLS)))
    return _Program(model, start, limits, margins, dt).to_rest(tolerance, fastest)


def _ramped(program: _Program, start: Start, V: float, margins: Margins) -> Move | None:
    """Ramp, cruise, ramp; None where the ramps need more than the distance."""
    distance = -float(start.x[0])
    cruise = V if distance > 0.0 else -V
    spare = 0.5 * min(margins.spare * abs(distance) / V, program.model.period)
    first, gone = program.ramp(cruise, spare)
    steady = np.zeros(len(start.x))
    steady[1] = cruise
    braking = program.begun_from(Start(program.carried(steady), 0.0))
    last, stopped = braking.ramp(0.0, spare)
    pause = (distance - gone - stopped) / cruise
    return joined(first, pause, last) if pause > 0.0 else None


@dataclass(frozen=True)
class _Scale:
    """Units of the program."""

    model: Model
    limits: Limits

    @property
    def a(self) -> float:
        return self.limits.acceleration

    @property
    def v(self) -> float:
        return self.a / float(self.model.omega[0])

    @property
    def x(self) -> float:
        return self.v / float(self.model.omega[0])

    @property
    def state(self) -> Array:
        pairs = 1 + len(self.model.omega)
        units = np.tile((self.x, self.v), pairs)
        return np.append(units, np.full(len(self.model.A) - 2 * pairs, self.a))


class _Program:
    """The linear programs of a start: unknown are the cells' accelerations and end velocities."""

    def __init__(
        self, model: Model, start: Start, limits: Limits, margins: Margins, dt: float
    ) -> None:
        self.model, self.start, self.limits, self.margins = model, start, limits, margins
        self.dt = dt
        self.v = model.commanded(start.x)  # m/s
        self.scale = _Scale(model, limits)
        self.nominal = _Reach(model.A, model.B, dt, self.scale, start)
        self.others = [
            _Reach(model.off(1.0 + off), model.B, dt, self.scale, start)
            for off in (-SPREAD, SPREAD)
        ]
        self.payload = np.zeros(len(model.A))
        self.payload[0] = 1.0
        self.payload[2 : 2 + 2 * len(model.omega) : 2] = 1.0

    def begun_from(self, start: Start) -> _Program:
        """The same from another start."""
        return _Program(self.model, start, self.limits, self.margins, self.dt)

    def carried(self, x: Array) -> Array:
        """A steady cruise's state: with air its modes hang back."""
        held = x.copy()
        modal = slice(2, 2 + 2 * len(self.model.omega))
        A = self.model.A
        held[modal] = -np.linalg.solve(A[modal, modal], A[modal, 1] * x[1])
        return held

    def to_rest(self, tolerance: float, fastest: float) -> Move:
        """The move to rest at the target, payload within ``tolerance`` m before that.

        ``fastest``: about what it takes, s.
        """
        tail = ceil(TAIL * self.model.period / self.dt)
        band = tolerance / self.scale.x
        goal = np.zeros(len(self.model.A))

        def solved(N: int, smooth: bool) -> Array | None:
            within = (N, N + tail, band)
            return self._solve(N + tail, goal, 0.0, smooth, within)

        guess = round((fastest + SETTLING * self.model.period) / self.dt)
        fewest = _fewest(lambda N: solved(N, False) is not None, guess)
        return self._smooth(solved, fewest, round(self.margins.spare * fewest))

    def ramp(self, v: float, spare: float) -> tuple[Move, float]:
        """The ramp to a cruise at ``v`` m/s, modes at rest, and the way it takes, m."""
        goal = self.carried(np.concatenate(([0.0, v], np.zeros(len(self.model.A) - 2))))

        def solved(N: int, smooth: bool) -> Array | None:
            return self._solve(N, goal / self.scale.state, v, smooth, None)

        fewest = _fewest(lambda N: solved(N, False) is not None, CELLS_PER_PERIOD)
        more = ceil(self.margins.spare * fewest + spare / self.dt)
        move = self._smooth(solved, fewest, more if self.margins.spare else 0)
        reached, way = self.v, 0.0
        for a in move.a:
            way += self.dt * (reached + 0.5 * a * self.dt)
            reached += a * self.dt
        return move, way

    def _smooth(self, solved: Callable[[int, bool], Array | None], fewest: int, more: int) -> Move:
        """The smooth plan of the fewest cells and some more; of more still, where none is found."""
        for beside in MORE_CELLS:
            a = solved(fewest + more + beside, True)
            if a is not None:
                return from_cells((a * self.scale.a).tolist(), self.dt)
        raise NoPlan("no plan is smooth enough")

    def _solve(
        self,
        M: int,
        goal: Array,
        v: float,
        smooth: bool,
        within: tuple[int, int, float] | None,
    ) -> Array | None:
        """Accelerations of ``M`` cells that reach ``goal``, in units of A; None: there are none."""
        if M < 1:
            return None
        step = self.dt * float(self.model.omega[0])
        V, A = self._bounds(M)
        one, none = np.eye(M), np.zeros((1, M))
        behind = one - np.eye(M, k=-1)
        v0 = self.v / self.scale.v
        ends = self.nominal.rows(np.eye(len(goal)), M)
        free = np.arange(len(goal)) if within else np.arange(1, len(goal))  # a ramp's way is open
        # The most jerk, and the most sway left in each of the modes that are made robust.
        extra = 1 + min(len(self.model.omega), ROBUST)

        def wide(cells: Array, unit: int | None = None, by: float = 0.0) -> Array:
            """Rows of cells, and ``by`` in the column of an extra unknown; no end velocities."""
            rows = np.zeros((len(cells), 2 * M + extra))
            rows[:, :M] = cells
            if unit is not None:
                rows[:, 2 * M + unit] = by
            return rows

        gained = np.hstack((-step * one, behind, np.zeros((M, extra))))
        equal = [gained, wide(ends[free])]
        first = np.zeros(M)
        first[0] = v0
        equal_to = [first, (goal - self.nominal.free(M))[free]]
        less, less_than = [], []
        if within:
            begin, end, band = within
            ahead = np.zeros((end - begin + 1, M))
            drift = np.zeros(len(ahead))
            for place, k in enumerate(range(begin, end + 1)):
                ahead[place, :k] = self.nominal.rows(self.payload[None], k)[0]
                drift[place] = self.payload @ self.nominal.free(k)
            less += [wide(ahead), wide(-ahead)]
            less_than += [band - drift, band + drift]
        cost = np.zeros(2 * M + extra)
        if smooth:
            jerk = np.vstack((one, none)) - np.vstack((none, one))
            a0 = np.zeros(M + 1)
            a0[0] = self.start.a / self.scale.a
            for sign in (1.0, -1.0):
                less.append(wide(sign * jerk, unit=0, by=-step))
                less_than.append(sign * a0)
                for mode in range(extra - 1):
                    left, at = self._left(mode, M, goal)
                    less.append(wide(sign * left, unit=1 + mode, by=-1.0))
                    less_than.append(-sign * at)
            cost[-extra:] = JERK_WEIGHT, 1.0, *(WAVES,) * (extra - 2)
        bounds = [*((-A, A),) * M, *zip(-V, V, strict=True), *((0.0, None),) * extra]
        bounds[0] = self._first(A, step)
        bounds[2 * M] = (0.0, self.margins.jerk)
        bounds[2 * M - 1] = (v / self.scale.v,) * 2
        program = {
            "A_ub": sparse.csr_matrix(np.vstack(less)) if less else None,
            "b_ub": np.concatenate(less_than) if less else None,
            "A_eq": sparse.csr_matrix(np.vstack(equal)),
            "b_eq": np.concatenate(equal_to),
            "bounds": bounds,
        }
        found: Any = linprog(cost, **program, method="highs", options=_QUICK)
        if found.status not in _ANSWERS:
            found = linprog(cost, **program, method="highs", options=_THOROUGH)
        return found.x[:M] if found.status == 0 else None

    def _first(self, A: float, step: float) -> tuple[float, float]:
        """Bounds of the first cell, which goes on from the command that it finds."""
        a, change = self.start.a / self.scale.a, self.margins.jerk * step
        return min(max(a - change, -A), A), max(min(a + change, A), -A)

    def _bounds(self, M: int) -> tuple[Array, float]:
        """Largest velocity at each cell's end and acceleration, in the program's units.

        Beyond the limit at the start, the velocity may come down to it as fast as planned.
        """
        A = self.margins.acceleration
        V = self.margins.velocity * self.limits.velocity / self.scale.v
        braked = abs(self.v) / self.scale.v - 0.9 * A * self.dt * float(
            self.model.omega[0]
        ) * np.arange(1, M + 1)
        return np.maximum(V, braked), A

    def _left(self, mode: int, M: int, goal: Array) -> tuple[Array, Array]:
        """Sway left in a mode at the end where frequencies are wrong: rows of the cells, and rest.

        Its displacement and its rate by omega, for each of the wrong frequencies.
        """
        pick = np.zeros((2, len(goal)))
        pick[0, 2 + 2 * mode] = 1.0
        pick[1, 3 + 2 * mode] = self.model.omega[0] / self.model.omega[mode]
        rows = [other.rows(pick, M) for other in self.others]
        rests = [pick @ (other.free(M) - goal) for other in self.others]
        return np.vstack(rows), np.concatenate(rests)


def _fewest(possible: Callable[[int], bool], guess: int) -> int:
    """The smallest number from 1 on for which ``possible``: steps from ``guess``, then bisection.

    The first step is of 2, each further one twice as long.
    """
    low, high, step = 0, max(1, guess), 2
    if possible(high):
        while high > step and possible(high - step):
            high, step = high - step, 2 * step
        low = max(0, high - step)
    else:
        low, high, step = high, high + step, 2 * step
        while not possible(high):
            low, high, step = high, high + step, 2 * step
            if high > MOST_CELLS:
                raise NoPlan(f"none of up to {low} cells keeps the limits and ends at rest")
    while high - low > 1:
        middle = (low + high) // 2
        if possible(middle):
            high = middle
        else:
            low = middle
    return high


class _Reach:
    """What the cells do to the state, and what it does by itself; in the program's units."""

    def __init__(self, A: Array, B: Array, dt: float, scale: _Scale, start: Start) -> None:
        Ad, Bd = discretised(A, B, dt)
        self._Ad = Ad * scale.state[None] / scale.state[:, None]
        self._moved = [Bd[:, 0] * scale.a / scale.state]  # by a cell, 0, 1, ... cells later
        self._free = [start.x / scale.state]

    def rows(self, seen: Array, cells: int) -> Array:
        """``seen`` (k, size) of the state after ``cells`` cells, by each of them, (k, cells)."""
        while len(self._moved) < cells:
            self._moved.append(self._Ad @ self._moved[-1])
        return np.asarray(seen @ np.array(self._moved[cells - 1 :: -1]).T)[:, :cells]

    def free(self, cells: int) -> Array:
        """The state after ``cells`` cells of no acceleration."""
        while len(self._free) <= cells:
            self._free.append(self._Ad @ self._free[-1])
        return self._free[cells]
