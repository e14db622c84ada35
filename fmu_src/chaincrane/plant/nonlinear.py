"""The nonlinear crane: large motions of a chain, in steps whose energy balance is checked.

The chain is the paper's truss, whose tension comes by its own stretch, or another formulation.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass, fields, replace

import numpy as np

from ..errors import EnergyBalanceBroken, NotConverged
from .chain import Array, DiscreteChain, along_elements, axial_force
from .command import Command
from .companion import TimeError, apart
from .crane import CraneModel, Posture, Solution
from .formulation import Formulation
from .inextensible import InextensibleChain
from .interface import LAST_COMMAND, NO_SLACK, NONLINEAR_STATE, NOT_PREDICTABLE
from .jump import plain_jump, settled, wave_time
from .ledger import Effort, Ledger
from .parameters import Crane, Initial, Numerics
from .scheme import Jump, Load, Motion
from .trolley import WHOLE, Trolley, equal_parts
from .truss import Truss

FORMULATION_CLASSES: dict[str, Callable[[DiscreteChain, Numerics], Formulation]] = {
    "truss": Truss,
    "inextensible": InextensibleChain,
}
MAX_HALVINGS = 12  # of an internal step that does not converge or breaks the energy balance
TOTAL_ENERGY_TOLERANCE = 5e-3  # of the energy put in so far, what the balance may be off by
JUMP_GAIN = 1e-4  # of the energy put in so far, what a jump may add
ROUND_OFF_ENERGY = 1e-9  # of weight times length, what round-off alone may amount to


@dataclass(frozen=True)
class NonlinearState:
    """All that a step starts from, besides the trolley."""

    motion: Motion
    last: Command | None  # of the last step; a change of load is a new start for the scheme
    ledger: Ledger
    energy: float  # J
    scale: float  # J, what errors are measured against, see _scale
    trolley_fx: float  # N
    slack_time: float = 0.0  # s


def jumps(before: Command, after: Command) -> bool:
    """Whether the load jumps between two steps; the trolley's velocity is no load."""
    return replace(before, trolley_v_cmd=after.trolley_v_cmd) != after


class NonlinearCrane(CraneModel):
    """The paper's nonlinear crane, section 2.1, with a scheme that is safe for stiff chains."""

    def __init__(
        self,
        crane: Crane | None = None,
        initial: Initial | None = None,
        numerics: Numerics | None = None,
    ) -> None:
        super().__init__(crane, initial, numerics)
        self._chain = FORMULATION_CLASSES[self.numerics.formulation](self.chain, self.numerics)
        self._scheme = self._chain.scheme
        motion = self._chain.straight(self.initial.sway_angle)
        energy = self._chain.energy(motion, self.trolley.v)
        self._error = TimeError()
        self._waves = 0.0  # s, for which steps still have to resolve the waves of a jump
        self._state = NonlinearState(
            motion=motion,
            last=None,
            ledger=Ledger(start=energy),
            energy=energy,
            scale=self._chain.potential(motion.r),
            trolley_fx=self._chain.released_force(motion, self.trolley.v),
        )
        self._companion = self._state if self.numerics.compares else None

    @property
    def energy(self) -> float:
        """Mechanical energy above the rest position, J."""
        return self._state.energy

    @property
    def ledger(self) -> Ledger:
        """The energy ledger."""
        return self._state.ledger

    @property
    def error_payload(self) -> float:
        """Estimated time error of the payload's place, m, the largest since the start."""
        return self._error.payload

    @property
    def motion(self) -> Motion:
        """Positions and velocities of the free nodes relative to the trolley."""
        return self._state.motion

    def internal_steps(self, h: float) -> int:
        """Number of equal internal steps for ``h`` seconds; the formulation may want more."""
        return equal_parts(h, self._longest)

    @property
    def _longest(self) -> float:
        """Longest internal step, s, where no jump has just been; the companion's is twice it."""
        allowed = self._chain.longest_step
        return min(self.numerics.max_step, 0.5 * allowed if self.numerics.compares else allowed)

    def _stretches(self, h: float, waves: float) -> list[tuple[float, float, int]]:
        """Start, s, duration, s, and internal steps of what ``h`` seconds are divided into.

        One stretch, or two where the waves of a jump, ``waves`` s, are to be resolved in the first.
        """
        if not (waves > 0.0 and self._chain.wave_step < self._longest):
            return [(0.0, h, self.internal_steps(h))]
        first = waves if waves < h * (1.0 - WHOLE) else h
        stretches = [(0.0, first, equal_parts(first, self._chain.wave_step))]
        if first < h:
            stretches.append((first, h - first, self.internal_steps(h - first)))
        return stretches

    def _jump(
        self, state: NonlinearState, command: Command, before: float, after: float
    ) -> tuple[NonlinearState, float]:
        """The trolley's velocity jumps, m/s: the state after it, and the drive's impulse, N s.

        What the jump leaves out of axial vibrations is booked as dissipated. That can be negative,
        down to -JUMP_GAIN of the scale; a filtered impulse that would add more is given up for the
        plain one.
        """
        chain, dv = self.chain, after - before
        if dv == 0.0:
            return state, 0.0
        jump = self._scheme.jump(state.motion, command, after, dv)
        impulse, work = self._impulse_work(jump, before, after)
        scale = self._scale(state.scale, after, state.ledger)
        most = state.energy + work + JUMP_GAIN * scale
        motion, energy, dissipated = jump.motion, self._chain.energy(jump.motion, after), 0.0
        if jump.tension is not None and energy > most:
            jump = plain_jump(chain, state.motion, dv)
            impulse, work = self._impulse_work(jump, before, after)
            motion, energy = jump.motion, self._chain.energy(jump.motion, after)
        if jump.tension is not None:
            motion = self._settled(motion, jump.tension, after, most)
            energy = self._chain.energy(motion, after)
            dissipated = state.energy + work - energy
        jumped = replace(
            state,
            motion=motion,
            last=None,
            ledger=state.ledger.booked(work, 0.0, dissipated),
            energy=energy,
            scale=scale,
        )
        return jumped, impulse

    def _impulse_work(self, jump: Jump, before: float, after: float) -> tuple[float, float]:
        """The drive's impulse, N s, all change of momentum; its work, J, at the mean velocity."""
        impulse = self.crane.total_mass * (after - before) + self._chain.momentum(jump.dw)
        return impulse, 0.5 * (before + after) * impulse

    def _settled(self, motion: Motion, tension: Array, trolley_v: float, most: float) -> Motion:
        """Elements at the lengths of ``tension``, or as far on the way as keeps ``most`` J."""
        length = np.hypot(*along_elements(motion.r).T)
        now = axial_force(self.crane.chain.EA, self.chain.L0, length)
        share = 1.0
        for _ in range(MAX_HALVINGS):
            after = settled(self.chain, motion, now + share * (tension - now))
            if self._chain.energy(after, trolley_v) <= most:
                return after
            share *= 0.5
        return motion

    def _advance(self, h: float, start: Trolley, command: Command) -> None:
        before, companion = self.trolley.v, self._companion
        state, impulse = self._jump(self._state, command, before, start.v)
        if companion is not None:
            companion, _ = self._jump(companion, command, before, start.v)
        waves = wave_time(self.crane, start.v - before) or self._waves
        error, effort = self._error, Effort()
        for begin, duration, count in self._stretches(h, waves):
            if companion is None:
                for i in range(count):
                    state, effort = self._internal_step(
                        state,
                        effort,
                        start,
                        command,
                        begin + i * duration / count,
                        duration / count,
                    )
            else:
                pairs = (count + 1) // 2
                part = duration / (2 * pairs)
                for i in range(pairs):
                    state, companion, error, effort = self._pair(
                        (state, companion, error, effort),
                        start,
                        command,
                        begin + 2 * i * part,
                        part,
                    )
        self._state, self._companion, self._error = state, companion, error
        self._waves = max(0.0, waves - h)
        self.effort = effort
        self.impulse = impulse

    def _pair(
        self,
        so_far: tuple[NonlinearState, NonlinearState, TimeError, Effort],
        start: Trolley,
        command: Command,
        elapsed: float,
        h: float,
    ) -> tuple[NonlinearState, NonlinearState, TimeError, Effort]:
        """Two internal steps of ``h`` s, one of the companion that is twice as long, compared."""
        state, companion, error, effort = so_far
        first, effort = self._internal_step(state, effort, start, command, elapsed, h)
        state, effort = self._internal_step(first, effort, start, command, elapsed + h, h)
        try:
            companion, effort = self._internal_step(
                companion, effort, start, command, elapsed, 2.0 * h
            )
        except (NotConverged, EnergyBalanceBroken):  # it goes on beside the finer one
            return state, state, error.lost(self.crane.chain.length), effort
        return state, companion, self._seen(error, first, state, companion), effort

    def _seen(
        self,
        error: TimeError,
        first: NonlinearState,
        second: NonlinearState,
        longer: NonlinearState,
    ) -> TimeError:
        """Time errors after two steps and one twice as long; forces are the steps' means."""
        tension = 0.5 * float(first.motion.tension[0] + second.motion.tension[0])
        force = 0.5 * (first.trolley_fx + second.trolley_fx)
        slack = second.slack_time > 0.0 or longer.slack_time > 0.0
        return error.seen(
            apart(second.motion, longer.motion),
            abs(tension - float(longer.motion.tension[0])),
            abs(force - longer.trolley_fx),
            self._chain.error_share(slack),
        )

    def _internal_step(
        self,
        state: NonlinearState,
        effort: Effort,
        start: Trolley,
        command: Command,
        elapsed: float,
        h: float,
    ) -> tuple[NonlinearState, Effort]:
        """One internal step; where it fails it is halved, at most MAX_HALVINGS times over."""
        pending = [(elapsed, h, 0)]
        while pending:
            elapsed, h, halvings = pending.pop()
            load = Load(start.v + elapsed * command.trolley_a_cmd, command)
            try:
                state, iterations = self._attempt(state, load, h)
                effort = Effort(effort.steps + 1, effort.iterations + iterations)
            except (NotConverged, EnergyBalanceBroken) as error:
                effort = Effort(effort.steps, effort.iterations + error.iterations)
                if halvings == MAX_HALVINGS:
                    when = self.start_time + self.time + elapsed
                    raise type(error)(f"at t = {when:.6g} s: {error}") from None
                pending.append((elapsed + 0.5 * h, 0.5 * h, halvings + 1))
                pending.append((elapsed, 0.5 * h, halvings + 1))
        return state, effort

    def _attempt(self, state: NonlinearState, load: Load, h: float) -> tuple[NonlinearState, int]:
        """One step of the scheme, with its energy balance checked."""
        motion = state.motion
        if state.last is None or jumps(state.last, load.command):  # accelerations start anew
            motion = Motion(motion.r, motion.w, motion.tension)
        with np.errstate(over="ignore", invalid="ignore"):  # the checks reject what overflows
            result = self._scheme.step(self._scheme.start(motion, load), load, h)
        ledger = state.ledger.booked(result.work_trolley, result.work_payload, result.dissipated)
        energy = self._chain.energy(result.motion, load.trolley_v_after(h))
        try:
            self._check_energy(state, ledger, energy, h)
        except EnergyBalanceBroken as error:
            error.iterations = result.iterations
            raise
        after = NonlinearState(
            motion=result.motion,
            last=load.command,
            ledger=ledger,
            energy=energy,
            scale=self._scale(state.scale, load.trolley_v_after(h), ledger),
            trolley_fx=result.trolley_fx,
            slack_time=state.slack_time + (h if result.motion.tension.min() < 0.0 else 0.0),
        )
        return after, result.iterations

    def _scale(self, before: float, trolley_v: float, ledger: Ledger) -> float:
        """What errors of energy are measured against, J: the largest so far of

            start above rest + (M + m) (v - v_start)^2/2 + |work of the payload's force|,

        what the trolley and the payload's force can have put into the swing, in any frame; in air,
        + (M + m) v^2/2, what a wind of the trolley's speed can.
        """
        mass = self.crane.total_mass
        changed = trolley_v - self.initial.speed
        wind = trolley_v if self.crane.damping.air else 0.0
        speed = self.initial.speed
        start = ledger.start - 0.5 * mass * speed * speed
        put_in = start + 0.5 * mass * (changed * changed + wind * wind) + abs(ledger.payload)
        return max(before, put_in)

    def _check_energy(self, state: NonlinearState, ledger: Ledger, energy: float, h: float) -> None:
        """Raise EnergyBalanceBroken where energy now differs from before + work - dissipation."""
        weight = self.crane.gravity * self.crane.total_mass
        floor = ROUND_OFF_ENERGY * weight * self.crane.chain.length
        scale = state.scale
        total = energy - ledger.expected
        step = total - (state.energy - state.ledger.expected)
        allowed = self._chain.step_energy_tolerance
        if not abs(step) <= allowed * scale + floor:
            raise EnergyBalanceBroken.in_step(h, step, scale, allowed)
        if not abs(total) <= TOTAL_ENERGY_TOLERANCE * scale + floor:
            raise EnergyBalanceBroken.since_start(total, scale, TOTAL_ENERGY_TOLERANCE)

    @property
    def _state_names(self) -> Collection[str]:
        return NONLINEAR_STATE

    def _save(self) -> list[Solution]:
        states = [self._state] if self._companion is None else [self._state, self._companion]
        return [self._saved(state) for state in states]

    def _saved(self, state: NonlinearState) -> Solution:
        motion = state.motion
        command = Command() if state.last is None else state.last
        numbers = {
            "loaded": float(state.last is not None),
            **{LAST_COMMAND + name: value for name, value in asdict(command).items()},
            "last_h": motion.last_h,
            "energy": state.energy,
            "scale": state.scale,
            "trolley_fx": state.trolley_fx,
            "slack_time": state.slack_time,
            "waves": self._waves,
            **{f"error_{name}": value for name, value in asdict(self._error).items()},
        }
        a = np.full_like(motion.r, np.nan) if motion.a is None else motion.a
        none = np.zeros_like(motion.tension)
        stretched = none if motion.stretched is None else motion.stretched
        nodal = (motion.r.ravel(), motion.w.ravel(), a.ravel())
        arrays = np.concatenate((*nodal, motion.tension, stretched))
        return Solution(numbers, arrays, state.ledger)

    def _load(self, solutions: list[Solution]) -> None:
        self._state, *companions = map(self._loaded, solutions)
        self._companion = companions[0] if companions else None
        numbers = solutions[0].numbers
        self._error = TimeError(*(numbers[f"error_{f.name}"] for f in fields(TimeError)))
        self._waves = numbers["waves"]

    def _loaded(self, solution: Solution) -> NonlinearState:
        n, numbers = self.chain.elements, solution.numbers
        nodal, tension, stretched = np.split(solution.arrays, (6 * n, 7 * n))
        r, w, a = nodal.reshape(3, n, 2)
        last_h = numbers["last_h"]
        command = {f.name: numbers[LAST_COMMAND + f.name] for f in fields(Command)}
        return NonlinearState(
            motion=Motion(
                r,
                w,
                tension,
                a=None if np.isnan(a).any() else a,
                stretched=stretched if last_h else None,
                last_h=last_h,
            ),
            last=Command(**command) if numbers["loaded"] else None,
            ledger=solution.ledger,
            energy=numbers["energy"],
            scale=numbers["scale"],
            trolley_fx=numbers["trolley_fx"],
            slack_time=numbers["slack_time"],
        )

    def _posture(self) -> Posture:
        return self._chain.posture(self._state.motion)

    def notice(self) -> str | None:
        """That the formulation does not hold, or that the motion is not predictable, where so."""
        if self._chain.never_slack and self._state.slack_time > 0.0:
            return NO_SLACK
        return None if self._error.predictable(self.crane.chain.length) else NOT_PREDICTABLE

    def _own_outputs(self) -> dict[str, float]:
        state = self._state
        return {
            "trolley.fx": state.trolley_fx,
            "chain.tension_top": float(state.motion.tension[0]),
            "chain.tension_min": float(state.motion.tension.min()),
            "chain.slack_time": state.slack_time,
            **{f"error.{name}": value for name, value in asdict(self._error).items()},
            "error.predictable": int(self._error.predictable(self.crane.chain.length)),
        }
