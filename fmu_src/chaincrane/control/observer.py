"""The observer: a steady-state Kalman filter on the string's modes, or on a massless rope.

It runs the string with the trolley's commands, exactly, and corrects it at each sample that its
sensor hears of. A late sample corrects the past, and the known commands since are run again. It can
find a steady wind, or a bias of its sensor, beside the motion, and leaves out samples that its
model says cannot be.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from math import atan, atan2, pi, sqrt
from typing import Any

import numpy as np

from ..errors import BadState, BadValue
from ..plant.chain import Array
from ..plant.command import Command
from ..plant.interface import MATERIAL_POINTS
from ..plant.linear import ModalMotion
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
    whole,
)
from . import kalman
from .design import (
    INPUTS_AT,
    MAX_MODES,
    SHOWN_MODES,
    ControlPart,
    check_design,
    design_string,
    drive_lag,
    elements_choice,
    model_choice,
    step_key,
)
from .drive import followed
from .sensor import Camera, Clock, Rope, Sensor

SENSORS = ("camera", "rope")
OFFSETS = ("wind", "bias", "none")
INTENSITY = {"camera": 0.02, "rope": 0.008}  # q^2 h/(r^2 omega_1^3), what the default q is made for
PATIENCE = 5  # samples in a row that are left out; the next one is believed
DEVIATIONS = (
    "payload.x_rel",
    "payload.vx_rel",
    "chain.mid_x_rel",
    "chain.top_angle",
    "wind.fx",
    "camera.bias_found",
    "rope.bias_found",
)
SHORTEST = 1e-3  # of sample_time: samples nearer than that share their gain
NONE_SHOWN = (0.0,) * SHOWN_MODES
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
        0.0,
        "assumed standard deviation q of the outer force on the payload, by its mass; 0: what the"
        " crane's size and the sensor's noise r suggest, q^2 h/(r^2 omega_1^3) = 0.02 (camera, r in"
        " m) or 0.008 (rope, r times the length), h the sample time",
        minimum=0.0,
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
    waves: float = parameter(
        "observer.noise.waves",
        None,
        0.09,
        "rope sensor: the filter follows each mode beyond the first within that share of its"
        " frequency, as far as it may be believed wrongly; no effect with a camera, which sees"
        " little of them",
        minimum=0.0,
    )


@dataclass(frozen=True)
class ObserverSettings:
    """What the observer believes, and what it sees."""

    crane: Crane = field(default_factory=Crane)
    mass_matrix: str = shared(Numerics, "mass_matrix")
    speed: float = shared(Initial, "speed")
    model: str = model_choice("observer")
    elements: int = elements_choice("observer")
    modes: int = whole("observer.modes", 4, (1, MAX_MODES), "number of modes of the model modes")
    lag: float = drive_lag()
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
    offset: str = choice(
        "observer.offset",
        OFFSETS[0],
        OFFSETS,
        f"{', '.join(OFFSETS)}: what the filter takes for the cause of a sway that stays; one"
        " sensor cannot tell a steady wind on the payload from a bias of its own",
    )
    periods: float = parameter(
        "observer.offset_periods",
        None,
        8.0,
        "periods of mode 1 in which the filter finds the offset",
        minimum=ABOVE_ZERO,
    )
    gate: float = parameter(
        "observer.gate",
        None,
        6.0,
        "standard deviations that a sample may be off what is expected; one beyond is left out. Of"
        f" a row of them the one after {PATIENCE} is believed, and half a period of mode 1 from"
        " there, as from the start, none is left out; 0: no gate",
        minimum=0.0,
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
    a: float  # m/s2, mean, of the trolley


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
    a: float = 0.0  # m/s2, of the trolley now
    steps: int = 0
    base_step: int = 0  # communication steps done at the base
    base_time: float = 0.0  # s
    base_pull: float = 0.0  # m/s2, what the trolley pulls the string with at the base
    pull: float = 0.0  # m/s2, and now
    offset: float = 0.0  # what a sample shows of wind or bias at rest, m or 1 (a slope)
    since: tuple[Segment, ...] = ()  # the base
    coming: tuple[Sample, ...] = ()
    tick: int = 0  # of the sensor's clock, the next to take
    taken: int = 0  # samples
    used: int = 0  # samples
    left_out: int = 0  # samples
    doubted: int = 0  # samples left out in a row
    surprised: float = 0.0  # s, when a sample beyond the gate was last believed, or the start
    believed: float = 0.0  # s, of the last sample used
    interval: float | None = None  # s, between the last two samples used; None: none used yet
    innovation: float = 0.0  # of the last sample used, m or rad


BLIND = ObserverInput()


class CraneObserver(ControlPart):
    """A filter that is run like a crane: step by step, with outputs of the cranes' names."""

    def __init__(self, settings: ObserverSettings | None = None) -> None:
        self.settings = one = settings or ObserverSettings()
        one.check()
        self.string = design_string(one.crane, one.model, one.elements, one.modes, one.mass_matrix)
        camera = one.sensor == "camera"
        self.clock = one.clock
        self.sensor = Sensor(one.clock, one.camera if camera else one.rope)
        string, omega = self.string, self.string.modes.omega
        none = np.zeros_like(omega)
        shown, by_force = (
            (string.end, string.end_by_force) if camera else (string.slope, string.slope_by_force)
        )
        self._left = string.end_left if camera else string.slope_left
        self._pull = {"wind": 1.0 / by_force, "bias": 0.0, "none": None}[one.offset]
        c = np.append(shown / omega, none)
        rows = np.vstack(  # of what a standard deviation is given for
            (
                np.append(string.end / omega, none),
                np.append(none, string.end),
                np.append(string.points[-1] / omega, none),
                np.append(string.slope / omega, none),
            )
        )
        if self._pull is not None:
            left = self._left[1] * self._pull
            c = np.append(c, left if one.offset == "wind" else 1.0)
            of_wind = (string.end_left[1], 0.0, string.points_left[-1, 1], string.slope_left[1])
            rows = np.column_stack((rows, np.array(of_wind) * self._pull))
        self.watched = kalman.Watched(string, c, self._assumed_noise(), self._pull)
        self._rows = rows
        self._filters: dict[float, kalman.Filter] = {}
        self._deviations: dict[tuple[float, float], list[float]] = {}
        rest = ModalMotion(none, none)
        self._state = Estimate(rest, rest, trolley=Trolley(v=one.speed))
        self.filter_for(self.clock.sample_time)

    def _assumed_noise(self) -> kalman.Noise:
        """The settings' noise; where they leave it open, by the crane's size."""
        one, assumed, h = self.settings, self.settings.noise, self.clock.sample_time
        omega = float(self.string.modes.omega[0])
        r = assumed.camera if one.sensor == "camera" else assumed.rope
        size = 1.0 if one.sensor == "camera" else one.crane.chain.length
        by_mass = assumed.payload
        if not by_mass:
            by_mass = sqrt(INTENSITY[one.sensor] * omega**3 / h) * r * size
        walk = r * sqrt(h) * omega / (2.0 * pi * one.periods)
        waves = assumed.waves if one.sensor == "rope" else 0.0
        return kalman.Noise(by_mass * one.crane.payload.mass, assumed.trolley, r, h, walk, waves)

    @property
    def estimate(self) -> Estimate:
        """The state of the observer."""
        return self._state

    def filter_for(self, interval: float) -> kalman.Filter:
        """The filter for samples every ``interval`` s, designed once. Raises BadValue."""
        interval = step_key(max(interval, SHORTEST * self.clock.sample_time))
        if interval not in self._filters:
            try:
                found = kalman.steady_state(self.watched, interval)
            except kalman.Unseen as error:
                raise self._unseen(interval, error) from None
            except kalman.NoFilter as error:
                raise self._too_noisy(error) from None
            if len(self._filters) >= _CACHED:
                self._filters.clear()
            self._filters[interval] = found
        return self._filters[interval]

    def _unseen(self, interval: float, why: kalman.NoFilter) -> BadValue:
        """The sampling that hides a mode, named as the FMU does."""
        own = interval == step_key(self.clock.sample_time)
        omega = self.string.modes.omega
        turns = omega * interval / pi
        nearest = int(np.argmin(np.abs(turns - np.maximum(np.round(turns), 1.0))))
        allowed = (
            f"a time at which the {self.settings.sensor} shows every mode, not half a period of one"
            f" ({omega[nearest]:.6g} rad/s): {why}"
        )
        return BadValue("sensor.sample_time" if own else "interval", interval, allowed)

    def _too_noisy(self, why: kalman.NoFilter) -> BadValue:
        """The assumed noise that leaves no filter: the disturbance that was set."""
        assumed, sensor = self.settings.noise, self.settings.sensor
        name = "payload" if assumed.payload else "trolley" if assumed.trolley else sensor
        measured = getattr(assumed, sensor)
        beside = "" if name == sensor else f" beside observer.noise.{sensor} = {measured:g}"
        allowed = f"a standard deviation that leaves a filter{beside}: {why}"
        return BadValue(f"observer.noise.{name}", getattr(assumed, name), allowed)

    def step(self, h: float, told: ObserverInput = BLIND) -> None:
        """Advance by ``h`` seconds.

        Raises BadValue, the observer as it was, for a value that is not allowed.
        """
        check_rows(told)
        check_step_size(h)
        state, command = self._state, told.command
        a_mean, a_end = followed(state.a, command.trolley_a_cmd, h, self.settings.lag)
        command = replace(command, trolley_a_cmd=a_mean)
        trolley = checked_after(state.trolley, h, command)
        camera = self.settings.sensor == "camera"
        seen = told.camera_x_rel if camera else told.rope_top_angle
        at_start = self.settings.inputs_at == "start"
        if at_start:
            state = self._sampled(state, seen)
        v = state.trolley.commanded(command)
        segment = Segment(h, v - state.trolley.v, v, command.trolley_a_cmd)
        state = replace(
            state,
            now=self._moved(state.now, segment, state.offset),
            time=state.time + h,
            trolley=trolley,
            a=a_end,
            pull=self._pull_after(segment),
            steps=state.steps + 1,
            since=(*state.since, segment),
        )
        if not at_start:
            state = self._sampled(state, seen)
        self._state = self._corrected(state)

    def _moved(self, motion: ModalMotion, segment: Segment, offset: float) -> ModalMotion:
        jumped = self.string.jump(motion, segment.dv)
        command = Command(trolley_a_cmd=segment.a, payload_fx=self._wind(offset))
        return self.string.propagate(jumped, segment.h, segment.v, command)

    def _wind(self, offset: float) -> float:
        """Force on the payload, N."""
        return offset * (self._pull or 0.0)

    def _bias(self, offset: float) -> float:
        """What a sample is off by, m or 1 (a slope)."""
        return offset if self.settings.offset == "bias" else 0.0

    def _pull_after(self, segment: Segment) -> float:
        """What the trolley pulls the string with at the end of a segment: a + alpha v, m/s2."""
        return segment.a + self.string.air * (segment.v + segment.h * segment.a)

    def _moved_on(
        self, motion: ModalMotion, segments: tuple[Segment, ...], offset: float
    ) -> ModalMotion:
        for segment in segments:
            motion = self._moved(motion, segment, offset)
        return motion

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
            state, corrected = self._judged(state, sample), True
        if corrected:
            state = replace(state, now=self._moved_on(state.base, state.since, state.offset))
        return state

    def _judged(self, state: Estimate, sample: Sample) -> Estimate:
        """The base moved to the sample's instant, and corrected unless the gate leaves it out."""
        passed = sample.step - state.base_step
        segments = state.since[:passed]
        interval = self.clock.sample_time
        if state.interval is not None or state.left_out:
            interval = sample.time - state.base_time
        found = self.filter_for(interval)
        state = replace(
            state,
            base=self._moved_on(state.base, segments, state.offset),
            base_step=sample.step,
            base_time=sample.time,
            base_pull=self._pull_after(segments[-1]) if segments else state.base_pull,
            since=state.since[passed:],
        )
        expected = self._expected(state)
        rope = self.settings.sensor == "rope"
        shown = sample.value - (atan(expected) if rope else expected)
        off = shown * (1.0 + expected**2) if rope else shown  # of a slope: tan to first order
        gate = self.settings.gate * found.surprise
        doubtful = gate > 0.0 and abs(shown) > gate
        shut = sample.time - state.surprised >= pi / float(self.string.modes.omega[0])
        state = replace(state, innovation=shown)
        if doubtful and shut and state.doubted < PATIENCE:
            return replace(state, left_out=state.left_out + 1, doubted=state.doubted + 1)
        state = self._corrected_by(state, found, off)
        surprised = sample.time if doubtful else state.surprised
        return replace(
            state, interval=found.interval, believed=sample.time, doubted=0, surprised=surprised
        )

    def _expected(self, state: Estimate) -> float:
        """A sample of the base without noise, m or 1 (a slope)."""
        camera = self.settings.sensor == "camera"
        row = self.string.end if camera else self.string.slope
        left = self._left @ (state.base_pull, self._wind(state.offset))
        return float(row @ state.base.eta + left) + self._bias(state.offset)

    def _corrected_by(self, state: Estimate, found: kalman.Filter, off: float) -> Estimate:
        """The state corrected by an innovation: z + k (y - c z)."""
        omega = self.string.modes.omega
        gain, n = found.gain * off, len(omega)
        base = ModalMotion(state.base.eta + gain[:n] / omega, state.base.rate + gain[n : 2 * n])
        offset = state.offset if self._pull is None else state.offset + float(gain[-1])
        return replace(state, base=base, offset=offset, used=state.used + 1)

    def deviations(self) -> list[float]:
        """Standard deviations, of DEVIATIONS, in the steady state, at the time reached.

        m, m/s, m, rad (small angles), then N, m and rad of wind and bias: 0 for what is not sought.
        """
        state = self._state
        since = round(state.time - state.believed, 9)
        if state.interval is None:
            found = self.filter_for(self.clock.sample_time)
            return self._roots(found.prior)
        key = (state.interval, since)
        if key not in self._deviations:
            found = self.filter_for(state.interval)
            if len(self._deviations) >= _CACHED:
                self._deviations.clear()
            covariance = kalman.predicted(self.watched, found, since)
            self._deviations[key] = self._roots(covariance)
        return self._deviations[key]

    def _roots(self, covariance: Array) -> list[float]:
        variances = np.einsum("ij,jk,ik->i", self._rows, covariance, self._rows)
        roots = np.sqrt(np.maximum(variances, 0.0)).tolist()
        offset = sqrt(max(float(covariance[-1, -1]), 0.0))
        bias = offset if self.settings.offset == "bias" else 0.0
        camera = self.settings.sensor == "camera"
        return [*roots, self._wind(offset), bias * camera, bias * (not camera)]

    def outputs(self) -> dict[str, float]:
        """All outputs by their FMU names, in SI units, in the interface's order."""
        state, string = self._state, self.string
        eta, rate, trolley = state.now.eta, state.now.rate, state.trolley
        wind = self._wind(state.offset)
        left = np.array((state.pull, wind))
        points = (string.points @ eta + string.points_left @ left).tolist()
        x_rel, vx_rel = points[MATERIAL_POINTS - 1], float(string.end @ rate)
        values: dict[str, float] = {
            "trolley.x": trolley.x,
            "trolley.v": trolley.v,
            "payload.x": trolley.x + x_rel,
            "payload.vx": trolley.v + vx_rel,
            "payload.x_rel": x_rel,
            "payload.vx_rel": vx_rel,
            "payload.sway_angle": atan2(x_rel, string.depth),
            "chain.mid_x_rel": points[-1],
            "chain.top_angle": atan(float(string.slope @ eta + string.slope_left @ left)),
        }
        for i, x in enumerate(points[:MATERIAL_POINTS], start=1):
            values[f"chain.x[{i}]"] = trolley.x + x
        for name, modal in (("x_rel", eta), ("vx_rel", rate)):
            shares = [*(string.end * modal).tolist(), *NONE_SHOWN][:SHOWN_MODES]
            for i, share in enumerate(shares, start=1):
                values[f"mode.{name}[{i}]"] = share
        values["wind.fx"] = wind
        camera = self.settings.sensor == "camera"
        values["camera.innovation"] = state.innovation if camera else 0.0
        values["rope.innovation"] = 0.0 if camera else state.innovation
        bias = self._bias(state.offset)
        values["camera.bias_found"] = bias if camera else 0.0
        values["rope.bias_found"] = 0.0 if camera else bias
        for name, deviation in zip(DEVIATIONS, self.deviations(), strict=True):
            values[f"std.{name}"] = deviation
        values["sensor.samples"] = state.used
        values["sensor.left_out"] = state.left_out
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
                "since": tuple(Segment(**one) for one in data["since"]),
                "coming": tuple(Sample(**one) for one in data["coming"]),
            }
        )
