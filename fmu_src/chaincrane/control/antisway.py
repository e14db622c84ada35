"""The anti-sway controller: a position for the trolley in, its acceleration out, within limits.

`planned` computes a plan to the target and regulates about it; where the payload is far from the
plan, after a push say, it plans anew. `lqr` regulates about the target itself. The other methods
are open-loop moves for comparison. The command acts over the communication step after the one that
computed it.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import hypot
from operator import attrgetter
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError

from ..errors import BadValue
from ..plant.chain import Array
from ..plant.parameters import Crane, Numerics
from ..variables import (
    check_rows,
    check_step_size,
    choice,
    held_input,
    parameter,
    shared,
    whole,
)
from . import plan, shapers
from .design import (
    INPUTS_AT,
    MAX_MODES,
    SHOWN_MODES,
    Carried,
    ControlPart,
    check_design,
    design_string,
    drive_lag,
    elements_choice,
    model_choice,
    step_key,
)
from .drive import followed
from .move import Limits, Move
from .regulator import Weights, design_model, discretised, regulator

METHODS = ("planned", "lqr", "zv", "zvd", "time_optimal", "trapezoid")
FEEDBACK = ("planned", "lqr")
ROUND_OFF = 1e-12  # of the velocity limit, kept free for round-off of the host's step size
CRUISE = 0.95  # of the velocity limit that lqr travels at: the rest is for damping the sway
SHORTEST = 1e-3  # of 1/omega_1: steps shorter than that share their gain
PAUSE = 0.25  # periods of mode 1 from a plan to one that a deviation asks for; then twice as long
MOST_ANEW = 4  # times twice
HASTE = 0.05  # periods of mode 1 from a plan to one for the next target: a target may slide
# The weights that a crane's size suggests, in A/omega_1^2, A and A omega_1. About a plan they are
# calm: what swings far beside it is planned anew.
POSITION = {"planned": 2.2, "lqr": 2.5}
SWAY = {"planned": 2.4, "lqr": 1.2}
ACCELERATION = {"planned": 0.16, "lqr": 0.5}
JERK = {"planned": 0.4, "lqr": 0.45}
WAVES = {"planned": 0.45, "lqr": 1.0}  # of the sway, in each mode beyond the first
SHARE = 2e-3
SHAPED = 2  # modes of zvd
MOVED = 2  # modes that a plan takes from an estimate: the others' sway is less than its noise
TOLERANCE, DEVIATION = 0.045, 0.12  # of A/omega_1^2
_CACHED = 64


def _share(name: str, unit: str, mode: int) -> Any:
    meaning = f"estimated share of mode {mode} in payload.{name}"
    return held_input(f"mode.{name}[{mode}]", unit, meaning)


def _sized(
    name: str, unit: str, meaning: str, number: float | Mapping[str, float], size: str
) -> Any:
    """A parameter that is a number, the method's, of a size of the crane's unless it is set."""
    by_method = number if isinstance(number, Mapping) else {}
    told = " or ".join(f"{one:g} ({method})" for method, one in by_method.items()) or f"{number:g}"
    words = f"{meaning}; 0: {told} {size}, A = limit.acceleration"
    return parameter(f"antisway.{name}", unit, 0.0, words, minimum=0.0, nominal=0.1)


@dataclass(frozen=True)
class Scales:
    """Deviations that weigh alike in the regulator's cost (Bryson & Ho 1975)."""

    position: float = _sized(
        "scale.position",
        "m",
        "regulator: deviation of the trolley that weighs like the other scales",
        POSITION,
        "A/omega_1^2",
    )
    sway: float = _sized(
        "scale.sway",
        "m",
        "regulator: sway of the payload, in each mode, that weighs like the other scales; planned:"
        f" in those beyond the first {WAVES['planned']:.2g} of it",
        SWAY,
        "A/omega_1^2",
    )
    acceleration: float = _sized(
        "scale.acceleration",
        "m/s2",
        "regulator: acceleration of the trolley that weighs like the other scales",
        ACCELERATION,
        "A",
    )
    jerk: float = _sized(
        "scale.jerk",
        "m/s3",
        "regulator: jerk of the trolley that weighs like the other scales",
        JERK,
        "A omega_1",
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
        f"{', '.join(METHODS)}: a plan and a regulator about it; a regulator about the target; or"
        " open loop a move shaped against sway (zero vibration, or zero vibration and derivative of"
        " two modes), the fastest move of the payload, or the fastest of the trolley",
    )
    model: str = model_choice("antisway")
    elements: int = elements_choice("antisway")
    modes: int = whole(
        "antisway.modes",
        4,
        (1, SHOWN_MODES),
        "number of modes that planned and lqr feed back, at most those that the model has",
    )
    planned_modes: int = whole(
        "antisway.planned_modes",
        0,
        (0, MAX_MODES),
        "number of modes that a plan brings to rest, at least those that are fed back and at most"
        " those that the model has; 0: more where the payload is light beside the chain",
    )
    inputs_at: str = choice(
        "antisway.inputs_at",
        INPUTS_AT[0],
        INPUTS_AT,
        f"{' or '.join(INPUTS_AT)} of the communication step: when the estimate is true; the"
        " regulator predicts one of the start to the end, where its command begins",
    )
    spare: float = parameter(
        "antisway.spare",
        None,
        0.09,
        "share of the shortest time to settle that a plan takes more, for robustness",
        minimum=0.0,
    )
    tolerance: float = _sized(
        "tolerance",
        "m",
        "planned: from settling on the payload stays that near to its target",
        TOLERANCE,
        "A/omega_1^2",
    )
    deviation: float = _sized(
        "deviation",
        "m",
        "planned: sway beside the plan from which on it is planned anew",
        DEVIATION,
        "A/omega_1^2",
    )
    lag: float = drive_lag()
    scales: Scales = field(default_factory=Scales)
    limits: Limits = field(default_factory=Limits)

    def check(self) -> None:
        """Raise BadValue for the first value that is not allowed; names are the FMU's."""
        check_design(self.crane, self.mass_matrix)
        check_rows(self)


@dataclass(frozen=True, kw_only=True)
class AntiSwayInput:
    """What the controller is told at a communication point."""

    target_x: float = held_input("target.x", "m", "where the payload is to go")
    trolley_x: float = held_input("trolley.x", "m", "where the trolley is")
    trolley_v: float = held_input("trolley.v", "m/s", "how fast it goes")
    mode_x_rel_1: float = _share("x_rel", "m", 1)
    mode_x_rel_2: float = _share("x_rel", "m", 2)
    mode_x_rel_3: float = _share("x_rel", "m", 3)
    mode_x_rel_4: float = _share("x_rel", "m", 4)
    mode_vx_rel_1: float = _share("vx_rel", "m/s", 1)
    mode_vx_rel_2: float = _share("vx_rel", "m/s", 2)
    mode_vx_rel_3: float = _share("vx_rel", "m/s", 3)
    mode_vx_rel_4: float = _share("vx_rel", "m/s", 4)
    wind_fx: float = held_input("wind.fx", "N", "estimated steady force on the payload")


def _told_state(modes: int) -> Any:
    """What takes trolley, and share and rate of each of the first modes, from an input."""
    shares = ((f"mode_x_rel_{i}", f"mode_vx_rel_{i}") for i in range(1, modes + 1))
    return attrgetter("trolley_x", "trolley_v", *(name for pair in shares for name in pair))


@dataclass(frozen=True)
class Designed:
    """What is designed for a length of step."""

    Ad: Array  # of the trolley and the modes that are fed back
    Bd: Array
    K: Array
    # Their state at the step's end, less what wind does, by [what is told; with a lag the trolley's
    # acceleration; wind; a].
    ahead: Array
    plan_Ad: Array  # of the trolley and the modes that are planned
    plan_Bd: Array


@dataclass
class Drive(Carried):
    """All that the controller carries from step to step."""

    time: float = 0.0  # s
    a: float = 0.0  # m/s2, commanded now
    v: float | None = None  # m/s, that the commands have given the trolley; None: no step yet
    follows: float = 0.0  # m/s2, of the trolley now, where the drive lags
    goal: float | None = None  # m, where the move ends; None: no move yet
    begun: float = 0.0  # s, when it began
    anew: int = 0  # plans in a row that a deviation has asked for
    move: Move = field(default_factory=Move)
    reference: Array = field(default_factory=lambda: np.zeros(0))  # the plan's state now
    reference_a: float = 0.0  # m/s2, the plan's acceleration over the last step


class AntiSway(ControlPart):
    """A controller that is run like a crane: step by step; its output is trolley.a_cmd."""

    def __init__(self, settings: AntiSwaySettings | None = None) -> None:
        self.settings = settings or AntiSwaySettings()
        self.settings.check()
        one = self.settings
        self.string = design_string(one.crane, one.model, one.elements, MAX_MODES, one.mass_matrix)
        there = len(self.string.modes.omega)
        self.modes = min(one.modes, there)
        self.planned_modes = min(
            max(one.planned_modes or self._worth_planning(), self.modes), there
        )
        self.model = plan.Model(
            *design_model(self.string, self.planned_modes, one.lag),
            self.string.modes.omega[: self.planned_modes],
            one.lag,
        )
        self.weights, self.tolerance, self.deviation = self._sizes()
        self._moved_omega = self.string.modes.omega[: min(MOVED, self.modes)].tolist()
        self._told_state = _told_state(self.modes)
        self.held_by_wind = self._steady()
        self.warning: str | None = None  # what a user should be told of this design
        self._designs: dict[float, Designed] = {}
        self._state: Drive = Drive()

    def _worth_planning(self) -> int:
        """Modes up to the last one that holds a SHARE of the payload's sway.

        Of the sway under a steady acceleration, phi_n phi^T b/omega^2, beside mode 1's.
        """
        string = self.string
        held = np.abs(string.end * string.push / string.modes.omega**2)
        return int(np.flatnonzero(held >= SHARE * held[0])[-1]) + 1

    def notice(self) -> str | None:
        """What a user should be told of this design, once; None: nothing."""
        return self.warning

    def _sizes(self) -> tuple[Weights, float, float]:
        """Weights, tolerance, deviation, SI: as set, or as the crane's size suggests."""
        one, A = self.settings, self.settings.limits.acceleration
        omega = float(self.string.modes.omega[0])
        length = A / omega**2
        method = one.method if one.method in FEEDBACK else FEEDBACK[0]
        sway = one.scales.sway or SWAY[method] * length
        weights = Weights(
            one.scales.position or POSITION[method] * length,
            sway,
            WAVES[method] * sway,
            one.scales.acceleration or ACCELERATION[method] * A,
            one.scales.jerk or JERK[method] * A * omega,
        )
        tolerance = one.tolerance or TOLERANCE * length
        return weights, tolerance, one.deviation or DEVIATION * length

    def design(self, h: float) -> Designed:
        """What belongs to steps of ``h`` s, designed once. Raises BadValue."""
        key = step_key(h)
        if key not in self._designs:
            A, B = design_model(self.string, self.modes, self.settings.lag)
            shortest = SHORTEST / float(self.string.modes.omega[0])
            try:
                longer = max(key, shortest)
                K = regulator(*discretised(A, B, longer), longer, self.modes, self.weights)
            except (LinAlgError, ValueError) as error:
                allowed = f"a step that the trolley can control every mode with ({error})"
                raise BadValue("step size", h, allowed) from None
            if len(self._designs) >= _CACHED:
                self._designs.clear()
            Ad, Bd = discretised(A, B, key)
            plan_Ad, plan_Bd = discretised(self.model.A, self.model.B, key)
            Bd, plan_Bd = Bd[:, 0], plan_Bd[:, 0]
            self._designs[key] = Designed(Ad, Bd, K, self._ahead(Ad, Bd), plan_Ad, plan_Bd)
        return self._designs[key]

    def step(self, h: float, told: AntiSwayInput) -> None:
        """Advance by ``h`` seconds.

        Raises BadValue, the controller as it was, for a value that is not allowed and for a target
        that no plan reaches.
        """
        check_rows(told)
        check_step_size(h)
        state = self._state.copy()
        start_v = told.trolley_v if state.v is None else state.v
        _, state.follows = followed(state.follows, state.a, h, self.settings.lag)
        state.time += h
        state.v = start_v + h * state.a
        if self.settings.method in FEEDBACK:
            wanted = self._regulate(state, h, told)
        else:
            self._start_move(state, h, told.trolley_x, told.target_x)
            wanted = state.move.mean(state.time - state.begun, h)
        state.a = self.limited(wanted, state.v, h)
        self._state = state

    # --- in closed loop -----------------------------------------------------------------------

    def _regulate(self, state: Drive, h: float, told: AntiSwayInput) -> float:
        """Move the reference on; its acceleration and what the regulator adds to it, m/s2."""
        one = self.design(h)
        x = self._predicted(one, told, state.follows)
        if self.settings.method == "lqr":
            far = CRUISE * self.settings.limits.velocity * one.K[1] / one.K[0]
            x[0] = min(max(x[0] - told.target_x, -far), far)
            return state.a - h * _jerk(one.K, x, state.a)
        self._refer(state, one, x, h, told.target_x)
        off = x - self._fed_back(state.reference)
        before = state.a - state.reference_a
        ahead = state.move.mean(state.time - state.begun, h)
        state.reference_a = ahead
        return ahead + before - h * _jerk(one.K, off, before)

    def _steady(self) -> Array:
        """Trolley and fed back modes at rest under 1 N of wind, the payload on its target.

        The trolley stands to windward of it.
        """
        string, modes = self.string, self.modes
        held = np.zeros(2 + 2 * modes + (self.settings.lag > 0.0))
        held[0] = -string.end_by_force
        held[2 : 2 + 2 * modes : 2] = string.end[:modes] ** 2 / string.modes.omega[:modes] ** 2
        return held

    def _ahead(self, Ad: Array, Bd: Array) -> Array:
        """What :meth:`_predicted` multiplies: inputs of the step's start move on to its end."""
        told = np.column_stack((np.eye(len(Ad)), -self.held_by_wind))
        if self.settings.inputs_at == "end":
            return np.column_stack((told, np.zeros(len(Ad))))
        return np.column_stack((Ad @ told, Bd))

    def _predicted(self, one: Designed, told: AntiSwayInput, follows: float) -> Array:
        """Trolley and fed back modes at the end of the step, less where a wind holds them.

        ``follows``: acceleration of a trolley that lags, then, m/s2.
        """
        before, at_start = self._state, self.settings.inputs_at == "start"
        lagging = (before.follows if at_start else follows,) if self.settings.lag else ()
        seen = np.array((*self._told_state(told), *lagging, told.wind_fx, before.a))
        x: Array = one.ahead.dot(seen)
        return x

    def _fed_back(self, reference: Array) -> Array:
        """The part of a plan's state that is fed back."""
        kept = reference[: 2 + 2 * self.modes]
        return np.append(kept, reference[-1]) if self.settings.lag else kept

    def _refer(self, state: Drive, one: Designed, x: Array, h: float, target: float) -> None:
        """Move the reference to the step's end; plan anew for another target or a deviation."""
        if state.goal is None:
            state.goal, state.reference = float(x[0]), self._from_estimate(None, x)
        else:
            state.reference = one.plan_Ad.dot(state.reference) + one.plan_Bd * state.reference_a
        since = state.time - state.begun
        if target != state.goal and (not state.move.a or since >= HASTE * self.model.period):
            state.anew = 0
            before = state.reference_a if state.move.a else state.a
            try:
                self._plan(state, state.reference, before, h, target)
            except plan.NoPlan as error:
                raise BadValue("target.x", target, f"one that a plan reaches: {error}") from None
            return
        if self._beside(x, state.reference) <= self.deviation:
            if since >= state.move.end:
                state.anew = 0
            return
        if since < PAUSE * self.model.period * 2.0**state.anew:
            return
        state.anew = min(state.anew + 1, MOST_ANEW)
        with contextlib.suppress(plan.NoPlan):
            anew = self._from_estimate(state.reference, x)
            self._plan(state, anew, state.a, h, state.goal)

    def _from_estimate(self, reference: Array | None, x: Array) -> Array:
        """A plan's state from an estimate; modes beyond MOVED as the plan has them."""
        size = len(self.model.A)
        whole_state = np.zeros(size) if reference is None else reference.copy()
        moved = 2 + 2 * min(MOVED, self.modes)
        whole_state[:moved] = x[:moved]
        if self.settings.lag:
            whole_state[-1] = x[-1]
        return whole_state

    def _beside(self, x: Array, reference: Array) -> float:
        """Sway beside the plan, m: the amplitudes of the modes that a plan would take over."""
        moved = slice(2, 2 + 2 * min(MOVED, self.modes))
        off = (x[moved] - reference[moved]).tolist()
        off_by_rate = (v / omega for v, omega in zip(off[1::2], self._moved_omega, strict=True))
        return sum(map(hypot, off[::2], off_by_rate))

    def _plan(self, state: Drive, reference: Array, a: float, h: float, target: float) -> None:
        """A new plan from a state of trolley and modes and a commanded acceleration.

        Raises plan.NoPlan, the state as it was.
        """
        x = reference.copy()
        x[0] -= target
        margins = plan.Margins(spare=self.settings.spare)
        start = plan.Start(x, a)
        limits = self.settings.limits
        state.move = plan.plan(self.model, start, limits, self.tolerance, margins, h)
        state.goal, state.begun = target, state.time
        state.reference, state.reference_a = reference, a

    # --- open loop ----------------------------------------------------------------------------

    def _start_move(self, state: Drive, h: float, x: float, target: float) -> None:
        """Begin an open-loop move where the last one has ended and the target is another."""
        if state.goal is None:
            state.goal = x
        if state.time - state.begun < state.move.end or target == state.goal:
            return
        try:
            state.move = self._open_move(target - state.goal, h)
        except plan.NoPlan as error:
            raise BadValue("target.x", target, f"one that a plan reaches: {error}") from None
        state.goal, state.begun = target, state.time

    def _open_move(self, distance: float, h: float) -> Move:
        limits, omega = self.settings.limits, self.string.modes.omega.tolist()
        if self.settings.method == "time_optimal":
            x = np.zeros(len(self.model.A))
            x[0] = -distance
            start = plan.Start(x, 0.0)
            return plan.plan(self.model, start, limits, self.tolerance, plan.FULL, h)
        move = shapers.trapezoid(distance, limits, h)
        if self.settings.method == "zv":
            return shapers.zv_shaped(move, omega[0], self.string.air)
        if self.settings.method == "zvd":
            return shapers.zvd_shaped(move, omega[:SHAPED], self.string.air)
        return move

    # --- all ----------------------------------------------------------------------------------

    def limited(self, a: float, v: float, h: float) -> float:
        """The acceleration nearest to ``a`` that keeps both limits over ``h`` s from ``v`` m/s."""
        limits = self.settings.limits
        top = limits.velocity * (1.0 - ROUND_OFF)
        a = min(max(a, (-top - v) / h), (top - v) / h)
        return min(max(a, -limits.acceleration), limits.acceleration)

    def outputs(self) -> dict[str, float]:
        """All outputs by their FMU names, in SI units, in the interface's order."""
        return {"trolley.a_cmd": self._state.a}

    def load(self, state: bytes) -> None:
        """Restore what :meth:`save` gave, in a controller with the same settings."""
        data = json.loads(state)
        move = Move(tuple(data["move"]["times"]), tuple(data["move"]["a"]))
        self._state = Drive(**data | {"move": move, "reference": np.array(data["reference"])})


def _jerk(K: Array, x: Array, a: float) -> float:
    """What the regulator makes of a state and a commanded acceleration, K [x; a], m/s3."""
    return float(K[:-1].dot(x) + K[-1] * a)
