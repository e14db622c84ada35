"""The observer: a steady-state Kalman filter on the linear crane, or on a massless-rope pendulum.

It runs the linear crane's own string with the trolley's commands, exactly, and corrects it at each
sample that its sensor hears of. A late sample corrects the past, and the known commands since are
run again.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from math import atan, atan2, isfinite, pi, tan
from typing import Any

import numpy as np

from . import kalman
from .chain import Array, discretise, interpolation
from .errors import BadState, BadValue
from .linear import ModalMotion, TautString
from .parameters import MATERIAL_POINTS, Crane, Initial, Numerics, check, check_number
from .sensor import Sensor
from .trolley import Trolley

MODELS = ("chain", "pendulum")
SENSORS = ("camera", "rope")
INPUTS_AT = ("start", "end")
MAX_ELEMENTS = 50
SHOWN_MODES = 2
_CACHED = 256  # designs and covariances kept, for hosts that vary their step


@dataclass(frozen=True)
class AssumedNoise:
    """What the filter takes for granted, as standard deviations."""

    camera: float = 0.002  # m, of each sample
    rope: float = 0.00873  # rad, half a degree, of each sample
    payload: float = 0.05  # m/s2, outer force on the payload by its mass, held between samples
    trolley: float = 0.0  # m/s2, of the trolley beside its command, held between samples


@dataclass(frozen=True)
class ObserverSettings:
    """What the observer believes, and what it sees."""

    crane: Crane = field(default_factory=Crane)
    speed: float = 0.8  # m/s, of the whole crane just before the start time
    model: str = "chain"  # or "pendulum", a massless rope
    elements: int = 2
    mass_matrix: str = "consistent"  # the paper's, or "averaged"
    sensor: str = "rope"  # or "camera"
    inputs_at: str = "start"  # or "end", of the communication step
    noise: AssumedNoise = field(default_factory=AssumedNoise)
    camera: Sensor = field(default_factory=Sensor)
    rope: Sensor = field(default_factory=Sensor)

    def check(self) -> None:
        """Raise BadValue for the first value that is not allowed; names are the FMU's."""
        check(self.crane, Initial(self.speed), Numerics(mass_matrix=self.mass_matrix))
        check_choice("observer.model", self.model, MODELS)
        check_choice("observer.sensor", self.sensor, SENSORS)
        check_choice("observer.inputs_at", self.inputs_at, INPUTS_AT)
        check_elements("observer.elements", self.elements)
        for name, value in asdict(self.noise).items():
            least = 0.0 if name == "trolley" else None
            allowed = "a finite number above 0" if least is None else "a finite number, 0 or above"
            check_number(
                f"observer.noise.{name}", value, allowed, test=lambda v, f=least: v > 0 or v == f
            )
        self.camera.check("camera")
        self.rope.check("rope")


def check_choice(name: str, value: object, choices: tuple[str, ...]) -> None:
    """Raise BadValue unless ``value`` is one of ``choices``."""
    if value not in choices:
        raise BadValue(name, value, "one of " + ", ".join(choices))


def check_elements(name: str, value: object) -> None:
    """Raise BadValue unless ``value`` is a number of elements to design with."""
    if not isinstance(value, int) or not 1 <= value <= MAX_ELEMENTS:
        raise BadValue(name, value, f"a whole number from 1 to {MAX_ELEMENTS}")


def design_crane(crane: Crane, model: str, elements: int) -> tuple[Crane, int]:
    """The crane and its elements that stand for ``model``: a pendulum is one massless element."""
    if model == "pendulum":
        return replace(crane, chain=replace(crane.chain, mass=0.0)), 1
    return crane, elements


@dataclass(frozen=True)
class Segment:
    """A communication step's known motion of the trolley."""

    h: float  # s
    dv: float  # m/s, jump at its start
    v: float  # m/s, after the jump
    a: float  # m/s2


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


class CraneObserver:
    """A filter that is run like a crane: step by step, with outputs of the cranes' names."""

    def __init__(self, settings: ObserverSettings | None = None) -> None:
        self.settings = settings or ObserverSettings()
        self.start_time = 0.0  # s, the host's
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
        self.sensor = self.settings.camera if camera else self.settings.rope
        assumed = self.settings.noise
        self.noise = kalman.Noise(
            assumed.payload * self.settings.crane.payload.mass,
            assumed.trolley,
            assumed.camera if camera else assumed.rope,
            self.sensor.sample_time,
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
        self.filter_for(self.sensor.sample_time)

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
        name = "sensor.sample_time" if interval == round(self.sensor.sample_time, 9) else "interval"
        omega = self.string.modes.omega[nearest]
        allowed = (
            f"a time at which the {sensor} shows every mode, not half a period of one"
            f" ({omega:.6g} rad/s): {why}"
        )
        return BadValue(name, interval, allowed)

    def step(
        self,
        h: float,
        v_cmd: float = 0.0,
        a_cmd: float = 0.0,
        x_rel: float = 0.0,
        top_angle: float = 0.0,
    ) -> None:
        """Advance by ``h`` s: the trolley's commands, m/s and m/s2, and what is to be seen, m, rad.

        Raises BadValue, the observer as it was, for a value that is not allowed.
        """
        check_number("trolley.v_cmd", v_cmd)
        check_number("trolley.a_cmd", a_cmd)
        check_number("camera.x_rel", x_rel)
        check_number("rope.top_angle", top_angle)
        check_number("step size", h, "a finite number above 0, s", test=lambda v: v > 0)
        state = self._state
        trolley = state.trolley.after(h, v_cmd, a_cmd)
        if not (isfinite(trolley.x) and isfinite(trolley.v)):
            allowed = "a command that keeps the trolley's motion finite"
            raise BadValue("trolley.v_cmd", v_cmd, allowed)
        seen = x_rel if self.settings.sensor == "camera" else top_angle
        at_start = self.settings.inputs_at == "start"
        if at_start:
            state = self._sampled(state, seen)
        v = state.trolley.commanded(v_cmd)
        segment = Segment(h, v - state.trolley.v, v, a_cmd)
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
        return self.string.propagate(jumped, segment.h, segment.v, segment.a, 0.0)

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
        interval = self.sensor.sample_time
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
            found = self.filter_for(self.sensor.sample_time)
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

    def output_values(self) -> list[float | int]:
        """All outputs in the interface's order, in SI units."""
        return list(self.outputs().values())

    def outputs(self) -> dict[str, float | int]:
        """All outputs by their FMU names, in SI units, in the interface's order."""
        state, shapes = self._state, self.string.modes.shapes
        eta, rate, trolley = state.now.eta, state.now.rate, state.trolley
        points = (self._points @ eta).tolist()
        x_rel, vx_rel = points[MATERIAL_POINTS - 1], float(shapes[-1] @ rate)
        values: dict[str, float | int] = {
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
                "since": tuple(Segment(**one) for one in data["since"]),
                "coming": tuple(Sample(**one) for one in data["coming"]),
            }
        )
