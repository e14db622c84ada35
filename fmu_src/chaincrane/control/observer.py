"""The observer: a steady-state Kalman filter on the linear crane, or on a massless-rope pendulum.

It runs the linear crane's own string with the trolley's commands, exactly, and corrects it at each
sample that its sensor hears of. A late sample corrects the past, and the known commands since are
run again.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from math import atan, atan2, pi, tan
from typing import Any

import numpy as np

from ..errors import BadState, BadValue
from ..plant.chain import Array, discretise, interpolation
from ..plant.command import Command
from ..plant.interface import MATERIAL_POINTS
from ..plant.linear import ModalMotion, TautString
from ..plant.parameters import Crane, Initial, Numerics
from ..plant.trolley import Trolley, checked_after
from ..variables import (
    ABOVE_ZERO,
    check_rows,
    check_step_size,
    choice,
    held_input,
    parameter,
    shared,
)
from . import kalman
from .design import (
    INPUTS_AT,
    SHOWN_MODES,
    ControlPart,
    check_design,
    design_crane,
    elements_choice,
    model_choice,
)
from .sensor import Camera, Clock, Rope, Sensor

SENSORS = ("camera", "rope")
_CACHED = 256  # designs and covariances kept, for hosts that vary their step


@dataclass(frozen=True)
class AssumedNoise:
    """What the filter takes for granted, as standard deviations."""

    camera: float = parameter(
        "observer.noise.camera",
        "m",
        0.002,
        "standard deviation that the filter assumes of a camera's sample",
        minimum=ABOVE_ZERO,
        nominal=1e-3,
    )
    rope: float = parameter(
        "observer.noise.rope",
        "rad",
        0.00873,  # half a degree
        "standard deviation that the filter assumes of a rope-angle sample",
        minimum=ABOVE_ZERO,
        nominal=1e-2,
    )
    payload: float = parameter(  # held between samples, as the next is
        "observer.noise.payload",
        "m/s2",
        0.05,
        "assumed standard deviation of the outer force on the payload, by its mass",
        minimum=ABOVE_ZERO,
        nominal=0.1,
    )
    trolley: float = parameter(
        "observer.noise.trolley",
        "m/s2",
        0.0,
        "assumed standard deviation of the trolley's acceleration beside its command",
        minimum=0.0,
        nominal=0.1,
    )


@dataclass(frozen=True)
class ObserverSettings:
    """What the observer believes, and what it sees."""

    crane: Crane = field(default_factory=Crane)
    mass_matrix: str = shared(Numerics, "mass_matrix")
    speed: float = shared(Initial, "speed")
    model: str = model_choice("observer")
    elements: int = elements_choice("observer")
    sensor: str = choice(
        "observer.sensor",
        "rope",
        SENSORS,
        f"{' or '.join(SENSORS)}: which of the two inputs is measured",
    )
    inputs_at: str = choice(
        "observer.inputs_at",
        INPUTS_AT[0],
        INPUTS_AT,
        f"{' or '.join(INPUTS_AT)} of the communication step: when the measured input is true;"
        " end where a master steps the plant first and hands its new outputs on",
    )
    noise: AssumedNoise = field(default_factory=AssumedNoise)
    clock: Clock = field(default_factory=Clock)
    camera: Camera = field(default_factory=Camera)
    rope: Rope = field(default_factory=Rope)

    def check(self) -> None:
        """Raise BadValue for the first value that is not allowed; names are the FMU's."""
        check_design(self.crane, self.mass_matrix, self.speed)
        check_rows(self)


@dataclass(frozen=True, kw_only=True)
class ObserverInput:
    """What the observer is told of a communication step, and what there is to see."""

    trolley_v_cmd: float = shared(Command, "trolley_v_cmd")
    trolley_a_cmd: float = shared(Command, "trolley_a_cmd")
    camera_x_rel: float = held_input(
        "camera.x_rel", "m", "what the camera looks at: connect payload.x_rel"
    )
    rope_top_angle: float = held_input(
        "rope.top_angle", "rad", "what the rope-angle sensor feels: connect chain.top_angle"
    )

    @property
    def command(self) -> Command:
        """The crane's command, as far as the observer knows it."""
        return Command(trolley_v_cmd=self.trolley_v_cmd, trolley_a_cmd=self.trolley_a_cmd)


@dataclass(frozen=True)
class Segment:
    """A communication step's known motion of the trolley."""

    h: float  # s
    dv: float  # m/s, jump at its start
    v: float  # m/s, after the jump
    command: Command


@dataclass(frozen=True)
class Sample:
    """A sample on its way to the filter."""

    step: int  # communication steps done when it was taken
    time: float  # s
    value: float  # as the sensor says


@dataclass(frozen=True)
class Estimate:
    """All that the observer carries from step to step."""

    base: ModalMotion  # corrected by all samples heard of, at the last one's instant
    now: ModalMotion  # the base, predicted to the time reached
    time: float = 0.0  # s
    trolley: Trolley = field(default_factory=Trolley)
    steps: int = 0
    base_step: int = 0  # communication steps done at the base
    base_time: float = 0.0  # s
    since: tuple[Segment, ...] = ()  # the base
    coming: tuple[Sample, ...] = ()
    tick: int = 0  # of the sensor's clock, the next to take
    taken: int = 0  # samples
    used: int = 0  # samples
    interval: float | None = None  # s, between the last two samples used; None: none used yet
    innovation: float = 0.0  # of the last sample used, m or rad


BLIND = ObserverInput()


class CraneObserver(ControlPart):
    """A filter that is run like a crane: step by step, with outputs of the cranes' names."""

    def __init__(self, settings: ObserverSettings | None = None) -> None:
        self.settings = settings or ObserverSettings()
        self.settings.check()
        crane, elements = design_crane(
            self.settings.crane, self.settings.model, self.settings.elements
        )
        chain = discretise(crane, elements, self.settings.mass_matrix)
        self.string = TautString(chain)
        shapes = self.string.modes.shapes
        self.top = -float(chain.rest[0, 1])  # m, depth of the first node, the payload and the rest
        self.depth = -float(chain.rest[-1, 1])
        fractions = np.append(np.arange(1, MATERIAL_POINTS + 1) / MATERIAL_POINTS, 0.5)
        self._points = interpolation(elements, fractions) @ shapes
        self._slope = shapes[0] / self.top
        camera = self.settings.sensor == "camera"
        off = self.settings.camera if camera else self.settings.rope
        self.clock, self.sensor = self.settings.clock, Sensor(self.settings.clock, off)
        assumed = self.settings.noise
        self.noise = kalman.Noise(
            assumed.payload * self.settings.crane.payload.mass,
            assumed.trolley,
            assumed.camera if camera else assumed.rope,
            self.clock.sample_time,
        )
        omega = self.string.modes.omega
        none = np.zeros_like(omega)
        self.c = np.append((shapes[-1] if camera else self._slope) / omega, none)
        self._rows = np.vstack(  # of what a standard deviation is given for
            (
                np.append(shapes[-1] / omega, none),
                np.append(none, shapes[-1]),
                np.append(self._points[-1] / omega, none),
                np.append(self._slope / omega, none),
            )
        )
        self._filters: dict[float, kalman.Filter] = {}
        self._deviations: dict[tuple[float, float], list[float]] = {}
        rest = ModalMotion(none, none)
        self._state = Estimate(rest, rest, trolley=Trolley(v=self.settings.speed))
        self.filter_for(self.clock.sample_time)

    @property
    def estimate(self) -> Estimate:
        """The state of the observer."""
        return self._state

    def filter_for(self, interval: float) -> kalman.Filter:
        """The filter for samples every ``interval`` s, designed once. Raises BadValue."""
        interval = round(interval, 9)
        if interval not in self._filters:
            try:
                found = kalman.steady_state(self.string, self.noise, self.c, interval)
            except kalman.NoFilter as error:
                raise self._unobservable(interval, error) from None
            if len(self._filters) >= _CACHED:
                self._filters.clear()
            self._filters[interval] = found
        return self._filters[interval]

    def _unobservable(self, interval: float, why: kalman.NoFilter) -> BadValue:
        """The choice that the sensor cannot serve, named as the FMU does."""
        sensor, elements = self.settings.sensor, len(self.string.modes.omega)
        turns = self.string.modes.omega * interval / pi
        nearest = int(np.argmin(np.abs(turns - np.maximum(np.round(turns), 1.0))))
        if elements > 2 and abs(turns[nearest] - max(round(turns[nearest]), 1)) > 1e-4:
            allowed = f"elements that the {sensor} can tell apart: {why}; take fewer"
            return BadValue("observer.elements", elements, allowed)
        name = "sensor.sample_time" if interval == round(self.clock.sample_time, 9) else "interval"
        omega = self.string.modes.omega[nearest]
        allowed = (
            f"a time at which the {sensor} shows every mode, not half a period of one"
            f" ({omega:.6g} rad/s): {why}"
        )
        return BadValue(name, interval, allowed)

    def step(self, h: float, told: ObserverInput = BLIND) -> None:
        """Advance by ``h`` seconds.

        Raises BadValue, the observer as it was, for a value that is not allowed.
        """
        check_rows(told)
        check_step_size(h)
        state, command = self._state, told.command
        trolley = checked_after(state.trolley, h, command)
        camera = self.settings.sensor == "camera"
        seen = told.camera_x_rel if camera else told.rope_top_angle
        at_start = self.settings.inputs_at == "start"
        if at_start:
            state = self._sampled(state, seen)
        v = state.trolley.commanded(command)
        segment = Segment(h, v - state.trolley.v, v, command)
        state = replace(
            state,
            now=self._moved(state.now, segment),
            time=state.time + h,
            trolley=trolley,
            steps=state.steps + 1,
            since=(*state.since, segment),
        )
        if not at_start:
            state = self._sampled(state, seen)
        self._state = self._corrected(state)

    def _moved(self, motion: ModalMotion, segment: Segment) -> ModalMotion:
        jumped = self.string.jump(motion, segment.dv)
        return self.string.propagate(jumped, segment.h, segment.v, segment.command)

    def _sampled(self, state: Estimate, seen: float) -> Estimate:
        """Take a sample, if the sensor's clock has ticked."""
        tick = self.sensor.due(state.time, state.tick)
        if tick is None:
            return state
        sample = Sample(state.steps, state.time, self.sensor.reading(seen, state.taken))
        coming = (*state.coming, sample)
        return replace(state, coming=coming, tick=tick + 1, taken=state.taken + 1)

    def _corrected(self, state: Estimate) -> Estimate:
        """Correct by the samples that have arrived, and predict from there to the time reached."""
        corrected = False
        while state.coming and self.sensor.heard(state.coming[0].time, state.time):
            sample, *coming = state.coming
            state = replace(state, coming=tuple(coming))
            if self.settings.sensor == "rope" and not abs(sample.value) < 0.5 * pi:
                continue  # beyond the horizontal a slope says nothing
            state, corrected = self._correct(state, sample), True
        if corrected:
            now = state.base
            for segment in state.since:
                now = self._moved(now, segment)
            state = replace(state, now=now)
        return state

    def _correct(self, state: Estimate, sample: Sample) -> Estimate:
        """The base, moved to the sample's instant and corrected: z + k (y - c z)."""
        base, passed = state.base, sample.step - state.base_step
        for segment in state.since[:passed]:
            base = self._moved(base, segment)
        interval = self.clock.sample_time
        if state.interval is not None:
            interval = sample.time - state.base_time
        found = self.filter_for(interval)
        omega, count = self.string.modes.omega, len(base.eta)
        expected = float(self.c[:count] @ (omega * base.eta))
        if self.settings.sensor == "rope":
            off, shown = tan(sample.value) - expected, sample.value - atan(expected)
        else:
            off = shown = sample.value - expected
        base = ModalMotion(
            base.eta + found.gain[:count] * off / omega, base.rate + found.gain[count:] * off
        )
        return replace(
            state,
            base=base,
            base_step=sample.step,
            base_time=sample.time,
            since=state.since[passed:],
            used=state.used + 1,
            interval=found.interval,
            innovation=shown,
        )

    def deviations(self) -> list[float]:
        """Standard deviations of payload.x_rel and its rate, chain.mid_x_rel and chain.top_angle.

        m, m/s, m, rad (small angles), in the steady state, at the time reached.
        """
        state = self._state
        since = round(state.time - state.base_time, 9)
        if state.interval is None:
            found = self.filter_for(self.clock.sample_time)
            return self._roots(found.prior)
        key = (state.interval, since)
        if key not in self._deviations:
            found = self.filter_for(state.interval)
            if len(self._deviations) >= _CACHED:
                self._deviations.clear()
            covariance = kalman.predicted(self.string, self.noise, found, since)
            self._deviations[key] = self._roots(covariance)
        return self._deviations[key]

    def _roots(self, covariance: Array) -> list[float]:
        variances = np.einsum("ij,jk,ik->i", self._rows, covariance, self._rows)
        return [float(root) for root in np.sqrt(np.maximum(variances, 0.0))]

    def outputs(self) -> dict[str, float]:
        """All outputs by their FMU names, in SI units, in the interface's order."""
        state, shapes = self._state, self.string.modes.shapes
        eta, rate, trolley = state.now.eta, state.now.rate, state.trolley
        points = (self._points @ eta).tolist()
        x_rel, vx_rel = points[MATERIAL_POINTS - 1], float(shapes[-1] @ rate)
        values: dict[str, float] = {
            "trolley.x": trolley.x,
            "trolley.v": trolley.v,
            "payload.x": trolley.x + x_rel,
            "payload.vx": trolley.v + vx_rel,
            "payload.x_rel": x_rel,
            "payload.vx_rel": vx_rel,
            "payload.sway_angle": atan2(x_rel, self.depth),
            "chain.mid_x_rel": points[-1],
            "chain.top_angle": atan(float(self._slope @ eta)),
        }
        for i, x in enumerate(points[:MATERIAL_POINTS], start=1):
            values[f"chain.x[{i}]"] = trolley.x + x
        for name, modal in (("x_rel", eta), ("vx_rel", rate)):
            shares = [*(shapes[-1] * modal).tolist(), 0.0][:SHOWN_MODES]
            for i, share in enumerate(shares, start=1):
                values[f"mode.{name}[{i}]"] = share
        camera = self.settings.sensor == "camera"
        values["camera.innovation"] = state.innovation if camera else 0.0
        values["rope.innovation"] = 0.0 if camera else state.innovation
        names = ("payload.x_rel", "payload.vx_rel", "chain.mid_x_rel", "chain.top_angle")
        for name, deviation in zip(names, self.deviations(), strict=True):
            values[f"std.{name}"] = deviation
        values["sensor.samples"] = state.used
        return values

    def save(self) -> bytes:
        """The whole state, bit for bit (a float's repr is exact); the settings are not in it."""
        return json.dumps(asdict(self._state), default=lambda array: array.tolist()).encode()

    def load(self, state: bytes) -> None:
        """Restore what :meth:`save` gave, in an observer with the same settings.

        Raises BadState, the observer unchanged, where the size does not fit.
        """
        data: Mapping[str, Any] = json.loads(state)
        motions = {
            name: ModalMotion(np.array(data[name]["eta"]), np.array(data[name]["rate"]))
            for name in ("base", "now")
        }
        if any(len(m.eta) != len(self.string.modes.omega) for m in motions.values()):
            raise BadState("the saved state is of an observer with another number of elements")
        self._state = Estimate(
            **dict(data)
            | motions
            | {
                "trolley": Trolley(**data["trolley"]),
                "since": tuple(
                    Segment(**one | {"command": Command(**one["command"])}) for one in data["since"]
                ),
                "coming": tuple(Sample(**one) for one in data["coming"]),
            }
        )
