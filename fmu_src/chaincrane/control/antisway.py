"""The anti-sway controller: a position for the trolley in, its acceleration out, within limits.

`lqr` feeds the estimated state back: trolley and first modes. `trapezoid` and `zv` are open-loop
moves for comparison: the fastest within the limits, and the same shaped by two impulses. The
command acts over the communication step after the one that computed it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from math import ceil, exp, pi, sqrt
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, expm, solve_discrete_are

from ..errors import BadValue
from ..plant.chain import Array, discretise
from ..plant.linear import TautString
from ..plant.parameters import Crane, Numerics
from ..variables import (
    ABOVE_ZERO,
    check_rows,
    check_step_size,
    choice,
    held_input,
    parameter,
    shared,
    whole,
)
from .design import (
    INPUTS_AT,
    SHOWN_MODES,
    ControlPart,
    check_design,
    design_crane,
    elements_choice,
    model_choice,
)

METHODS = ("lqr", "zv", "trapezoid")
ROUND_OFF = 1e-12  # of the velocity limit, kept free for round-off of the host's step size
CRUISE = 0.95  # of the velocity limit that lqr travels at: the rest is for damping the sway
_CACHED = 64


def _share(name: str, unit: str, mode: int) -> Any:
    meaning = f"estimated share of mode {mode} in payload.{name}"
    return held_input(f"mode.{name}[{mode}]", unit, meaning)


@dataclass(frozen=True)
class Limits:
    """What the trolley's drive can do."""

    velocity: float = parameter(
        "limit.velocity", "m/s", 0.5, "largest speed of the trolley", minimum=ABOVE_ZERO
    )
    acceleration: float = parameter(
        "limit.acceleration", "m/s2", 1.0, "largest acceleration of the trolley", minimum=ABOVE_ZERO
    )


@dataclass(frozen=True)
class Scales:
    """Deviations that weigh alike in the regulator's cost (Bryson & Ho 1975)."""

    position: float = parameter(
        "antisway.scale.position",
        "m",
        0.2,
        "lqr: deviation of the trolley that weighs like the other scales",
        minimum=ABOVE_ZERO,
        nominal=0.1,
    )
    sway: float = parameter(
        "antisway.scale.sway",
        "m",
        0.1,
        "lqr: sway of the payload, in each mode, that weighs like the other scales",
        minimum=ABOVE_ZERO,
        nominal=0.1,
    )
    acceleration: float = parameter(
        "antisway.scale.acceleration",
        "m/s2",
        0.5,
        "lqr: acceleration of the trolley that weighs like the other scales",
        minimum=ABOVE_ZERO,
    )


@dataclass(frozen=True)
class AntiSwaySettings:
    """What the controller believes, and how it drives."""

    crane: Crane = field(default_factory=Crane)
    mass_matrix: str = shared(Numerics, "mass_matrix")
    method: str = choice(
        "antisway.method",
        METHODS[0],
        METHODS,
        f"{', '.join(METHODS)}: state feedback, or open loop a move shaped against sway (zero"
        " vibration) or the plain fastest move",
    )
    model: str = model_choice("antisway")
    elements: int = elements_choice("antisway")
    modes: int = whole("antisway.modes", 1, (1, SHOWN_MODES), "number of modes that lqr feeds back")
    inputs_at: str = choice(
        "antisway.inputs_at",
        INPUTS_AT[0],
        INPUTS_AT,
        f"{' or '.join(INPUTS_AT)} of the communication step: when the estimate is true; lqr"
        " predicts one of the start to the end, where its command begins",
    )
    scales: Scales = field(default_factory=Scales)
    limits: Limits = field(default_factory=Limits)

    def check(self) -> None:
        """Raise BadValue for the first value that is not allowed; names are the FMU's."""
        check_design(self.crane, self.mass_matrix)
        check_rows(self)
        most = 1 if self.model == "pendulum" else min(SHOWN_MODES, self.elements)
        if self.modes > most:
            allowed = f"a whole number from 1 to {most}, the modes of the model that are estimated"
            raise BadValue("antisway.modes", self.modes, allowed)


@dataclass(frozen=True, kw_only=True)
class AntiSwayInput:
    """What the controller is told at a communication point."""

    target_x: float = held_input("target.x", "m", "where the trolley is to go")
    trolley_x: float = held_input("trolley.x", "m", "where it is")
    trolley_v: float = held_input("trolley.v", "m/s", "how fast it goes")
    mode_x_rel_1: float = _share("x_rel", "m", 1)
    mode_x_rel_2: float = _share("x_rel", "m", 2)
    mode_vx_rel_1: float = _share("vx_rel", "m/s", 1)
    mode_vx_rel_2: float = _share("vx_rel", "m/s", 2)

    def modes(self, count: int) -> list[float]:
        """Share of payload.x_rel and its rate, m and m/s, of each of the first ``count`` modes."""
        shares = self.mode_x_rel_1, self.mode_x_rel_2
        rates = self.mode_vx_rel_1, self.mode_vx_rel_2
        return [value for pair in zip(shares[:count], rates, strict=False) for value in pair]


def design_model(string: TautString, modes: int) -> tuple[Array, Array]:
    """xdot = A x + B a of the trolley and the first ``modes`` modes, SI units.

    x = [trolley.x - target, trolley.v, then for each mode its share of payload.x_rel and its
    rate]; per mode q'' + alpha q' + omega^2 q = -gamma (a + alpha v), gamma = phi_n phi^T b.
    """
    size = 2 + 2 * modes
    A, B = np.zeros((size, size)), np.zeros((size, 1))
    A[0, 1] = B[1, 0] = 1.0
    for mode in range(modes):
        q, rate = 2 + 2 * mode, 3 + 2 * mode
        gamma = string.modes.shapes[-1, mode] * string.push[mode]
        A[q, rate] = 1.0
        A[rate, q] = -(string.modes.omega[mode] ** 2)
        A[rate, rate] = -string.air
        A[rate, 1] = -gamma * string.air
        B[rate, 0] = -gamma
    return A, B


def discretised(A: Array, B: Array, h: float) -> tuple[Array, Array]:
    """x(h) = Ad x(0) + Bd a with a held: one matrix exponential of [A B; 0 0] h."""
    size = len(A)
    both = np.zeros((size + 1, size + 1))
    both[:size, :size], both[:size, size:] = A, B
    grown = expm(both * h)
    return grown[:size, :size], grown[:size, size:]


def regulator(Ad: Array, Bd: Array, scales: Scales) -> Array:
    """Gain K, (size,), of a = -K x that minimises the sum of x^T Q x + a^2/acceleration^2.

    Q weighs position and each mode's sway by their scales. K = (R + B^T S B)^-1 B^T S A with S from
    scipy.linalg.solve_discrete_are.
    """
    weights = np.zeros(len(Ad))
    weights[0] = scales.position**-2
    weights[2::2] = scales.sway**-2
    R = np.array([[scales.acceleration**-2]])
    S = solve_discrete_are(Ad, Bd, np.diag(weights), R)
    K: Array = np.linalg.solve(R + Bd.T @ S @ Bd, Bd.T @ S @ Ad)[0]
    return K


@dataclass(frozen=True)
class Piece:
    """A time of constant acceleration."""

    start: float  # s
    end: float  # s
    a: float  # m/s2


def trapezoid(distance: float, limits: Limits, h: float) -> tuple[Piece, ...]:
    """The fastest move from rest to rest whose phases are whole steps of ``h`` s.

    n steps of acceleration a, m of cruise, n of braking: distance = a h^2 n (n + m). On this grid
    the held command is the move itself, so it ends where it should.
    """
    length = abs(distance)
    V, A = limits.velocity, limits.acceleration
    whole = 1.0 - 1e-9  # a ratio that is whole but for round-off counts as whole
    if length * A <= V * V:  # never reaches the limit of velocity
        n, m = max(1, ceil(sqrt(length / A) / h * whole)), 0
    else:
        n = max(1, ceil(V / (A * h) * whole))
        m = max(0, ceil(length / (V * h) * whole) - n)
    a = distance / (h * h * n * (n + m))
    return Piece(0.0, n * h, a), Piece((n + m) * h, (2 * n + m) * h, -a)


def zv_shaped(pieces: Sequence[Piece], omega: float, air: float) -> tuple[Piece, ...]:
    """The move given twice, half a damped period apart, so that the two swings cancel.

    Zero-vibration shaper (Singer & Seering 1990): impulses 1/(1+k) and k/(1+k) with
    k = exp(-zeta pi/sqrt(1 - zeta^2)), zeta = alpha/(2 omega). Overdamped: not shaped.
    """
    zeta = 0.5 * air / omega
    if zeta >= 1.0:
        return tuple(pieces)
    k = exp(-zeta * pi / sqrt(1.0 - zeta**2))
    half = pi / (omega * sqrt(1.0 - zeta**2))
    first = tuple(replace(piece, a=piece.a / (1.0 + k)) for piece in pieces)
    second = (Piece(p.start + half, p.end + half, p.a * k / (1.0 + k)) for p in pieces)
    return first + tuple(second)


def velocity_gained(pieces: Sequence[Piece], t: float) -> float:
    """Velocity, m/s, at ``t`` s of a move from rest."""
    return sum(p.a * (min(max(t, p.start), p.end) - p.start) for p in pieces)


@dataclass(frozen=True)
class Drive:
    """All that the controller carries from step to step."""

    time: float = 0.0  # s
    a: float = 0.0  # m/s2, commanded now
    v: float | None = None  # m/s, that the commands have given the trolley; None: no step yet
    goal: float | None = None  # m, where the last open-loop move ends
    begun: float = 0.0  # s, when it began
    move: tuple[Piece, ...] = ()


class AntiSway(ControlPart):
    """A controller that is run like a crane: step by step; its output is trolley.a_cmd."""

    def __init__(self, settings: AntiSwaySettings | None = None) -> None:
        self.settings = settings or AntiSwaySettings()
        self.settings.check()
        one = self.settings
        crane, elements = design_crane(one.crane, one.model, one.elements)
        self.string = TautString(discretise(crane, elements, one.mass_matrix))
        self._design: dict[float, tuple[Array, Array, Array]] = {}
        self._state = Drive()

    def design(self, h: float) -> tuple[Array, Array, Array]:
        """Ad, Bd and the regulator's gain for steps of ``h`` s, designed once. Raises BadValue."""
        h = round(h, 9)
        if h not in self._design:
            Ad, Bd = discretised(*design_model(self.string, self.settings.modes), h)
            try:
                K = regulator(Ad, Bd, self.settings.scales)
            except (LinAlgError, ValueError) as error:
                allowed = f"a step that the trolley can control every mode with ({error})"
                raise BadValue("step size", h, allowed) from None
            if len(self._design) >= _CACHED:
                self._design.clear()
            self._design[h] = Ad, Bd, K
        return self._design[h]

    def step(self, h: float, told: AntiSwayInput) -> None:
        """Advance by ``h`` seconds.

        Raises BadValue, the controller as it was, for a value that is not allowed.
        """
        check_rows(told)
        check_step_size(h)
        state = self._state
        start_v = told.trolley_v if state.v is None else state.v
        state = replace(state, time=state.time + h, v=start_v + h * state.a)
        if self.settings.method == "lqr":
            wanted = self._regulated(h, state.a, told)
        else:
            state = self._moving(state, h, told.trolley_x, told.target_x)
            t = state.time - state.begun
            wanted = (velocity_gained(state.move, t + h) - float(state.v or 0.0)) / h
        self._state = replace(state, a=self.limited(wanted, float(state.v or 0.0), h))

    def _regulated(self, h: float, a: float, told: AntiSwayInput) -> float:
        """a = -K x, x at the end of this step; far from the target, towards a steady cruise."""
        Ad, Bd, K = self.design(h)
        trolley = [told.trolley_x - told.target_x, told.trolley_v]
        x = np.array(trolley + told.modes(self.settings.modes))
        if self.settings.inputs_at == "start":
            x = Ad @ x + Bd[:, 0] * a
        far = CRUISE * self.settings.limits.velocity * K[1] / K[0]
        x[0] = min(max(x[0], -far), far)
        return -float(K @ x)

    def _moving(self, state: Drive, h: float, x: float, target: float) -> Drive:
        """Begin an open-loop move where the last one has ended and the target is another."""
        goal = x if state.goal is None else state.goal
        ended = all(state.time - state.begun >= piece.end for piece in state.move)
        if not ended or target == goal:
            return replace(state, goal=goal)
        move = trapezoid(target - goal, self.settings.limits, h)
        if self.settings.method == "zv":
            move = zv_shaped(move, float(self.string.modes.omega[0]), self.string.air)
        return replace(state, goal=target, begun=state.time, move=move)

    def limited(self, a: float, v: float, h: float) -> float:
        """The acceleration nearest to ``a`` that keeps both limits over ``h`` s from ``v`` m/s."""
        limits = self.settings.limits
        top = limits.velocity * (1.0 - ROUND_OFF)
        a = min(max(a, (-top - v) / h), (top - v) / h)
        return min(max(a, -limits.acceleration), limits.acceleration)

    def outputs(self) -> dict[str, float]:
        """All outputs by their FMU names, in SI units, in the interface's order."""
        return {"trolley.a_cmd": self._state.a}

    def save(self) -> bytes:
        """The whole state, bit for bit (a float's repr is exact); the settings are not in it."""
        return json.dumps(asdict(self._state)).encode()

    def load(self, state: bytes) -> None:
        """Restore what :meth:`save` gave, in a controller with the same settings."""
        data = json.loads(state)
        self._state = Drive(**data | {"move": tuple(Piece(**piece) for piece in data["move"])})
