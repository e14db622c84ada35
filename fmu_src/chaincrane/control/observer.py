"""The observer: a steady-state Kalman filter on the string's modes, or on a massless rope.

It runs the string with the trolley's commands, exactly, and corrects it at each sample that its
sensor hears of. A late sample corrects the past, and the known commands since are run again. It can
find a steady wind, or a bias of its sensor, beside the motion, and leaves out samples that its
model says cannot be.

The state z is the filter's (:mod:`kalman`), an offset last where one is sought. What is seen of it
is linear: each output, the sample and its deviations are rows of one matrix.

A rope-angle sensor has two filters, which hear the same samples. The estimate is of one that is
sure of the frequencies, quiet, and late to believe in a push. What is fed back is of a cautious
one, noisier, so that waves hardly grow where their frequencies are believed wrongly.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import atan, atan2, pi, sqrt
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg

from ..errors import BadState, BadValue
from ..plant.chain import Array
from ..plant.command import Command
from ..plant.interface import MATERIAL_POINTS
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
from .sensor import Camera, Clock, Rope, Sensor

SENSORS = ("camera", "rope")
OFFSETS = ("wind", "bias", "none")
INTENSITY = {"camera": 0.02, "rope": 0.004}  # q^2 h/(r^2 omega_1^3), what the default q is made for
CAUTIOUS = 0.03  # the same, of the cautious filter
STEEP = 1.0  # slope beyond which a correction grows no more: a string is no model of it
PATIENCE = 5  # samples in a row that are left out; the next one is believed
DEVIATIONS = (
    "std.payload.x_rel",
    "std.payload.vx_rel",
    "std.chain.mid_x_rel",
    "std.chain.top_angle",
    "std.wind.fx",
    "std.camera.bias_found",
    "std.rope.bias_found",
)
SHORTEST = 1e-3  # of sample_time: samples nearer than that share their gain
# What is seen of the state: places of the rows of its matrix, material points the first.
PAYLOAD, MIDDLE, TOP = MATERIAL_POINTS - 1, MATERIAL_POINTS, MATERIAL_POINTS + 1
SHARES = slice(TOP + 1, TOP + 1 + SHOWN_MODES)
RATE = SHARES.stop  # of the payload
RATE_SHARES = slice(RATE + 1, RATE + 1 + SHOWN_MODES)
OUTPUTS = (
    "trolley.x",
    "trolley.v",
    "payload.x",
    "payload.vx",
    "payload.x_rel",
    "payload.vx_rel",
    "payload.sway_angle",
    "chain.mid_x_rel",
    "chain.top_angle",
    *(f"chain.x[{i}]" for i in range(1, MATERIAL_POINTS + 1)),
    *(f"mode.x_rel[{i}]" for i in range(1, SHOWN_MODES + 1)),
    *(f"mode.vx_rel[{i}]" for i in range(1, SHOWN_MODES + 1)),
    "wind.fx",
    "camera.innovation",
    "rope.innovation",
    "camera.bias_found",
    "rope.bias_found",
    *DEVIATIONS,
    "sensor.samples",
    "sensor.left_out",
)
_CACHED = 256  # designs and covariances kept, for hosts that vary their step
_STEPS = 32  # lengths of step whose exact steps are kept


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
        " crane's size and the sensor's noise r (rope: times the length) suggest, q^2 h/(r^2"
        " omega_1^3) = 0.02 (camera), 0.004 (rope) or 0.03 (rope, what is fed back), h the sample"
        " time",
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
        0.18,
        "rope sensor: what is fed back, mode.* and wind.fx, is of a second filter that follows each"
        " mode beyond the first within that share of its frequency, as far as it may be believed"
        " wrongly; 0: of the same filter as the rest; no effect with a camera, which sees little of"
        " them",
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


class Segment(NamedTuple):
    """A communication step's known motion of the trolley."""

    h: float  # s
    dv: float  # m/s, jump at its start
    v: float  # m/s, after the jump
    a: float  # m/s2, mean, of the trolley


class Sample(NamedTuple):
    """A sample on its way to the filter."""

    step: int  # communication steps done when it was taken
    time: float  # s
    value: float  # as the sensor says


@dataclass
class Estimate(Carried):
    """All that the observer carries from step to step.

    An offset is what a sample shows of wind or bias at rest, m or 1 (a slope).
    """

    base: Array  # z, a row of each filter, corrected by all samples heard of, at the last's instant
    now: Array  # the base, predicted to the time reached
    time: float = 0.0  # s
    trolley: Trolley = field(default_factory=Trolley)
    a: float = 0.0  # m/s2, of the trolley now
    steps: int = 0
    base_step: int = 0  # communication steps done at the base
    base_time: float = 0.0  # s
    base_pull: float = 0.0  # m/s2, what the trolley pulls the string with at the base
    pull: float = 0.0  # m/s2, and now
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


class Filters(NamedTuple):
    """What the observer runs."""

    estimate: kalman.Filter
    fed_back: kalman.Filter  # cautious; the same where one serves both
    gains: Array  # a row of each that there is


BLIND = ObserverInput()


class CraneObserver(ControlPart):
    """One filter or two, run like a crane: step by step, with outputs of the cranes' names."""

    def __init__(self, settings: ObserverSettings | None = None) -> None:
        self.settings = one = settings or ObserverSettings()
        one.check()
        self.string = design_string(one.crane, one.model, one.elements, one.modes, one.mass_matrix)
        self._camera = camera = one.sensor == "camera"
        self.clock = one.clock
        self.sensor = Sensor(one.clock, one.camera if camera else one.rope)
        by_force = self.string.end_by_force if camera else self.string.slope_by_force
        self._pull = {"wind": 1.0 / by_force, "bias": 0.0, "none": None}[one.offset]
        self._seen, self._pulled = self._sights()
        shown = PAYLOAD if camera else TOP
        c, self._shown_pulled = self._seen[shown].copy(), float(self._pulled[shown])
        if one.offset == "bias":
            c[-1] = 1.0
        self.watched, self.cautious = (
            kalman.Watched(self.string, c, self._assumed_noise(cautious), self._pull)
            for cautious in (False, True)
        )
        one_for_all = self.cautious.noise == self.watched.noise
        self._run = (self.watched,) if one_for_all else (self.watched, self.cautious)
        self._exact: dict[float, tuple[Array, Array]] = {}
        self._half_period = pi / float(self.string.modes.omega[0])
        self._filters: dict[float, Filters] = {}
        self._deviations: dict[tuple[float, float], list[float]] = {}
        rest = np.zeros((len(self._run), len(c)))
        self._state: Estimate = Estimate(rest, rest, trolley=Trolley(v=one.speed))
        self.filters_for(self.clock.sample_time)

    def _sights(self) -> tuple[Array, Array]:
        """What is seen of z, a row each, and by 1 m/s2 that the trolley pulls the string with.

        Material points and the middle, m, the slope at the top, the modes' shares of payload.x_rel,
        then the rate of it and their shares, m/s.
        """
        string, omega = self.string, self.string.modes.omega
        share = np.eye(SHOWN_MODES, len(omega)) * string.end
        displaced = np.vstack((string.points, string.slope, share)) / omega
        moving = np.vstack((string.end, share))
        rows: Array = scipy.linalg.block_diag(displaced, moving)
        left = np.zeros((len(rows), 2))  # by what the modes left out move, at rest
        left[: SHARES.start] = np.vstack((string.points_left, string.slope_left))
        if self._pull is not None:
            rows = np.column_stack((rows, left[:, 1] * self._pull))
        return rows, left[:, 0]

    def _assumed_noise(self, cautious: bool) -> kalman.Noise:
        """A filter's noise, as set; where the settings leave it open, by the crane's size."""
        one, assumed, h = self.settings, self.settings.noise, self.clock.sample_time
        omega = float(self.string.modes.omega[0])
        r = assumed.camera if one.sensor == "camera" else assumed.rope
        size = 1.0 if one.sensor == "camera" else one.crane.chain.length
        waves = assumed.waves if cautious and one.sensor == "rope" else 0.0
        by_mass = assumed.payload
        if not by_mass:
            intensity = CAUTIOUS if waves else INTENSITY[one.sensor]
            by_mass = sqrt(intensity * omega**3 / h) * r * size
        walk = r * sqrt(h) * omega / (2.0 * pi * one.periods)
        return kalman.Noise(by_mass * one.crane.payload.mass, assumed.trolley, r, h, walk, waves)

    @property
    def estimate(self) -> Estimate:
        """The state of the observer."""
        return self._state

    def filters_for(self, interval: float) -> Filters:
        """The filters for samples every ``interval`` s, designed once. Raises BadValue."""
        interval = step_key(max(interval, SHORTEST * self.clock.sample_time))
        if interval not in self._filters:
            try:
                found = [kalman.steady_state(one, interval) for one in self._run]
            except kalman.Unseen as error:
                raise self._unseen(interval, error) from None
            except kalman.NoFilter as error:
                raise self._too_noisy(error) from None
            if len(self._filters) >= _CACHED:
                self._filters.clear()
            gains = np.array([one.gain for one in found])
            self._filters[interval] = Filters(found[0], found[-1], gains)
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
        state, at_start = self._state.copy(), self.settings.inputs_at == "start"
        seen = told.camera_x_rel if self._camera else told.rope_top_angle
        if at_start:
            self._sample(state, seen)
            self._correct(state)
        self._drive(state, h, told)
        if not at_start:
            self._sample(state, seen)
        self._correct(state)
        self._state = state

    def _drive(self, state: Estimate, h: float, told: ObserverInput) -> None:
        """Move trolley and string on by ``h`` s. Raises BadValue if they do not stay finite."""
        a, a_end = followed(state.a, told.trolley_a_cmd, h, self.settings.lag)
        command = Command(trolley_v_cmd=told.trolley_v_cmd, trolley_a_cmd=a)
        trolley = checked_after(state.trolley, h, command)
        v = state.trolley.commanded(command)
        segment = Segment(h, v - state.trolley.v, v, a)
        state.now = self._moved(state.now, segment)
        state.time += h
        state.trolley, state.a = trolley, a_end
        state.pull = self._pull_after(segment)
        state.steps += 1
        state.since = (*state.since, segment)

    def _moved(self, z: Array, segment: Segment) -> Array:
        """Each filter's z after a segment, exactly: Phi z + Gamma (dv, v, a)."""
        phi, gamma = self._exact_step(segment.h)
        moved: Array = z.dot(phi.T) + gamma.dot(segment[1:])
        return moved

    def _exact_step(self, h: float) -> tuple[Array, Array]:
        """Phi and Gamma of ``h`` s, made once."""
        if h not in self._exact:
            if len(self._exact) >= _STEPS:
                self._exact.clear()
            self._exact[h] = self.watched.transition(h), self.watched.driven(h)
        return self._exact[h]

    def _offset(self, z: Array) -> float:
        """The offset in a filter's z, m or 1 (a slope); 0 where none is sought."""
        return 0.0 if self._pull is None else float(z[-1])

    def _wind(self, offset: float) -> float:
        """Force on the payload, N."""
        return offset * (self._pull or 0.0)

    def _bias(self, offset: float) -> float:
        """What a sample is off by, m or 1 (a slope)."""
        return offset if self.settings.offset == "bias" else 0.0

    def _pull_after(self, segment: Segment) -> float:
        """What the trolley pulls the string with at the end of a segment: a + alpha v, m/s2."""
        return segment.a + self.string.air * (segment.v + segment.h * segment.a)

    def _moved_on(self, z: Array, segments: tuple[Segment, ...]) -> Array:
        for segment in segments:
            z = self._moved(z, segment)
        return z

    def _sample(self, state: Estimate, seen: float) -> None:
        """Take a sample, if the sensor's clock has ticked."""
        tick = self.sensor.due(state.time, state.tick)
        if tick is None:
            return
        sample = Sample(state.steps, state.time, self.sensor.reading(seen, state.taken))
        state.coming = (*state.coming, sample)
        state.tick = tick + 1
        state.taken += 1

    def _correct(self, state: Estimate) -> None:
        """Correct by the samples that have arrived, and predict from there to the time reached."""
        while state.coming and self.sensor.heard(state.coming[0].time, state.time):
            sample, *coming = state.coming
            state.coming = tuple(coming)
            if self._camera or abs(sample.value) < 0.5 * pi:  # a rope beyond it has no slope
                self._judge(state, sample)

    def _judge(self, state: Estimate, sample: Sample) -> None:
        """Move the base to the sample's instant; correct it unless the gate leaves that out."""
        passed = sample.step - state.base_step
        segments, since = state.since[:passed], state.since[passed:]
        interval = self.clock.sample_time
        if state.interval is not None or state.left_out:
            interval = _lasted(segments, state.base_time, sample.time)
        found = self.filters_for(interval)
        base = self._moved_on(state.base, segments) if since else state.now
        if segments:
            state.base_pull = self._pull_after(segments[-1])
        expected = base.dot(self.watched.c) + self._shown_pulled * state.base_pull  # m or 1 (slope)
        off = [self._off(sample.value, one) for one in expected.tolist()]
        state.base, state.base_step, state.base_time = base, sample.step, sample.time
        state.since = since
        state.innovation = off[0][0]
        gate = self.settings.gate * found.fed_back.surprise  # of the one that believes in a push
        doubtful = gate > 0.0 and abs(off[-1][0]) > gate
        shut = sample.time - state.surprised >= self._half_period
        if doubtful and shut and state.doubted < PATIENCE:
            state.left_out += 1
            state.doubted += 1
            return
        state.base = base + found.gains * np.array([[by] for _, by in off])
        state.now = self._moved_on(state.base, since)
        state.used += 1
        state.interval = found.estimate.interval
        state.believed = sample.time
        state.doubted = 0
        if doubtful:
            state.surprised = sample.time

    def _off(self, value: float, expected: float) -> tuple[float, float]:
        """A sample less what was expected: as the sensor says, and of what ``expected`` is of."""
        if self._camera:
            return value - expected, value - expected
        shown = value - atan(expected)
        slope = min(abs(expected), STEEP)
        return shown, shown * (1.0 + slope**2)  # of a slope: tan to first order

    def deviations(self) -> list[float]:
        """Standard deviations, of DEVIATIONS, in the steady state, at the time reached.

        m, m/s, m, rad (small angles), then N, m and rad of wind and bias: 0 for what is not sought.
        """
        state = self._state
        since = state.time - state.believed
        if not state.doubted:  # the sample believed is the base's
            since = _lasted(state.since, state.believed, state.time)
        since = round(since, 9)
        if state.interval is None:
            found = self.filters_for(self.clock.sample_time)
            return self._roots(found.estimate.prior, found.fed_back.prior)
        key = (state.interval, since)
        if key not in self._deviations:
            found = self.filters_for(state.interval)
            if len(self._deviations) >= _CACHED:
                self._deviations.clear()
            each = zip(self._run, found[:2], strict=False)
            errors = [kalman.predicted(watched, one, since) for watched, one in each]
            self._deviations[key] = self._roots(errors[0], errors[-1])
        return self._deviations[key]

    def _roots(self, estimate: Array, fed_back: Array) -> list[float]:
        """Deviations of two error covariances; the wind is what is fed back."""
        rows = self._seen[[PAYLOAD, RATE, MIDDLE, TOP]]
        variances = np.einsum("ij,jk,ik->i", rows, estimate, rows)
        roots = np.sqrt(np.maximum(variances, 0.0)).tolist()
        offset, steady = (sqrt(max(float(P[-1, -1]), 0.0)) for P in (estimate, fed_back))
        bias = offset if self.settings.offset == "bias" else 0.0
        return [*roots, self._wind(steady), bias * self._camera, bias * (not self._camera)]

    def outputs(self) -> dict[str, float]:
        """All outputs by their FMU names, in SI units, in the interface's order."""
        return dict(zip(OUTPUTS, self.output_values(), strict=True))

    def output_values(self) -> list[float]:
        """All outputs, of OUTPUTS, in SI units."""
        state, trolley, now = self._state, self._state.trolley, self._state.now
        sights = (now.dot(self._seen.T) + self._pulled * state.pull).tolist()
        seen, fed_back = sights[0], sights[-1]
        x_rel, vx_rel = seen[PAYLOAD], seen[RATE]
        bias = self._bias(self._offset(now[0]))
        of_camera, of_rope = (state.innovation, bias), (0.0, 0.0)
        if not self._camera:
            of_camera, of_rope = of_rope, of_camera
        return [
            trolley.x,
            trolley.v,
            trolley.x + x_rel,
            trolley.v + vx_rel,
            x_rel,
            vx_rel,
            atan2(x_rel, self.string.depth),
            seen[MIDDLE],
            atan(seen[TOP]),
            *[trolley.x + x for x in seen[:MATERIAL_POINTS]],
            *fed_back[SHARES],
            *fed_back[RATE_SHARES],
            self._wind(self._offset(now[-1])),
            of_camera[0],
            of_rope[0],
            of_camera[1],
            of_rope[1],
            *self.deviations(),
            state.used,
            state.left_out,
        ]

    def load(self, state: bytes) -> None:
        """Restore what :meth:`save` gave, in an observer with the same settings.

        Raises BadState, the observer unchanged, where the size does not fit.
        """
        data: Mapping[str, Any] = json.loads(state)
        motions = {name: np.array(data[name]) for name in ("base", "now")}
        if any(motion.shape != self._state.now.shape for motion in motions.values()):
            raise BadState("the saved state is of an observer with other modes or filters")
        self._state = Estimate(
            **dict(data)
            | motions
            | {
                "trolley": Trolley(**data["trolley"]),
                "since": tuple(Segment(*one) for one in data["since"]),
                "coming": tuple(Sample(*one) for one in data["coming"]),
            }
        )


def _lasted(segments: Sequence[Segment], start: float, end: float) -> float:
    """Time of segments, s; of one its own length, free of the round-off of times added up."""
    return segments[0].h if len(segments) == 1 else end - start
