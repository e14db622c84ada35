"""The observer's interface, in one table: variables, units, start values, ranges, meanings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from . import interface
from .observer import (
    INPUTS_AT,
    MAX_ELEMENTS,
    MODELS,
    SENSORS,
    SHOWN_MODES,
    AssumedNoise,
    ObserverSettings,
)
from .parameters import MATERIAL_POINTS, Chain, Crane, Damping, Payload
from .sensor import MAX_SEED, Sensor
from .variables import TINY, Variable, input_variable, output, parameter

_SETTINGS, _NOISE, _SENSOR = ObserverSettings(), AssumedNoise(), Sensor()
_SHARED = {variable.name: variable for variable in interface.VARIABLES}
BELIEVED = (  # the cranes' parameters that a model for control design has
    "chain.length",
    "chain.mass",
    "chain.EA",
    "payload.mass",
    "gravity",
    "damping.air",
    "chain.mass_matrix",
)


def design_model(part: str, model: str, elements: int) -> tuple[Variable, Variable]:
    """Rows of the model that a part is designed from; ``part`` begins their names."""
    return (
        parameter(
            f"{part}.model",
            None,
            model,
            f"{' or '.join(MODELS)}: the taut string, or a massless rope",
            kind="String",
        ),
        parameter(
            f"{part}.elements",
            None,
            elements,
            "number of finite elements of the chain",
            kind="Integer",
            minimum=1,
            maximum=MAX_ELEMENTS,
        ),
    )


INPUTS = (
    _SHARED["trolley.v_cmd"],
    _SHARED["trolley.a_cmd"],
    input_variable("camera.x_rel", "m", "what the camera looks at: connect payload.x_rel"),
    input_variable(
        "rope.top_angle", "rad", "what the rope-angle sensor feels: connect chain.top_angle"
    ),
)

PARAMETERS = (
    *(_SHARED[name] for name in (*BELIEVED, "initial.speed")),
    *design_model("observer", _SETTINGS.model, _SETTINGS.elements),
    parameter(
        "observer.sensor",
        None,
        _SETTINGS.sensor,
        f"{' or '.join(SENSORS)}: which of the two inputs is measured",
        kind="String",
    ),
    parameter(
        "observer.inputs_at",
        None,
        _SETTINGS.inputs_at,
        f"{' or '.join(INPUTS_AT)} of the communication step: when the measured input is true;"
        " end where a master steps the plant first and hands its new outputs on",
        kind="String",
    ),
    parameter(
        "observer.noise.camera",
        "m",
        _NOISE.camera,
        "standard deviation that the filter assumes of a camera's sample",
        minimum=TINY,
        nominal=1e-3,
    ),
    parameter(
        "observer.noise.rope",
        "rad",
        _NOISE.rope,
        "standard deviation that the filter assumes of a rope-angle sample",
        minimum=TINY,
        nominal=1e-2,
    ),
    parameter(
        "observer.noise.payload",
        "m/s2",
        _NOISE.payload,
        "assumed standard deviation of the outer force on the payload, by its mass",
        minimum=TINY,
        nominal=0.1,
    ),
    parameter(
        "observer.noise.trolley",
        "m/s2",
        _NOISE.trolley,
        "assumed standard deviation of the trolley's acceleration beside its command",
        minimum=0.0,
        nominal=0.1,
    ),
    parameter(
        "sensor.sample_time",
        "s",
        _SENSOR.sample_time,
        "of the sensor's clock; samples are taken at communication points",
        minimum=TINY,
        nominal=0.01,
    ),
    parameter(
        "sensor.delay", "s", _SENSOR.delay, "until a sample arrives; the filter knows", minimum=0.0
    ),
    parameter(
        "sensor.seed",
        None,
        _SENSOR.seed,
        "of the noise; the same seed gives the same bits",
        kind="Integer",
        minimum=0,
        maximum=MAX_SEED,
    ),
    parameter("camera.noise", "m", _SENSOR.noise, "standard deviation of each sample", minimum=0.0),
    parameter(
        "camera.bias", "m", _SENSOR.bias, "what each sample is off by, unknown to the filter"
    ),
    parameter("rope.noise", "rad", _SENSOR.noise, "standard deviation of each sample", minimum=0.0),
    parameter(
        "rope.bias", "rad", _SENSOR.bias, "what each sample is off by, unknown to the filter"
    ),
)

_PLAIN = (
    "trolley.x",
    "trolley.v",
    "payload.x",
    "payload.vx",
    "payload.x_rel",
)
OUTPUTS = (
    *(_SHARED[name] for name in _PLAIN),
    output("payload.vx_rel", "m/s", "payload.vx - trolley.v"),
    *(_SHARED[n] for n in ("payload.sway_angle", "chain.mid_x_rel", "chain.top_angle")),
    *(_SHARED[f"chain.x[{i}]"] for i in range(1, MATERIAL_POINTS + 1)),
    *(
        output(f"mode.x_rel[{i}]", "m", f"share of mode {i} in payload.x_rel")
        for i in range(1, SHOWN_MODES + 1)
    ),
    *(
        output(f"mode.vx_rel[{i}]", "m/s", f"share of mode {i} in payload.vx_rel")
        for i in range(1, SHOWN_MODES + 1)
    ),
    output("camera.innovation", "m", "last sample less what was expected; 0 with the other sensor"),
    output("rope.innovation", "rad", "last sample less what was expected; 0 with the other sensor"),
    *(
        output(f"std.{name}", unit, f"standard deviation of {name}'s error, in the steady state")
        for name, unit in (
            ("payload.x_rel", "m"),
            ("payload.vx_rel", "m/s"),
            ("chain.mid_x_rel", "m"),
            ("chain.top_angle", "rad"),
        )
    ),
    output("sensor.samples", None, "samples used since the start", kind="Integer"),
)

VARIABLES = INPUTS + PARAMETERS + OUTPUTS


def believed_crane(full: Mapping[str, Any]) -> Crane:
    """The crane that a design is for, from the FMU's parameter values by name."""
    return Crane(
        chain=Chain(full["chain.length"], full["chain.mass"], full["chain.EA"]),
        payload=Payload(full["payload.mass"]),
        gravity=full["gravity"],
        damping=Damping(air=full["damping.air"]),
    )


def settings(values: Mapping[str, Any]) -> ObserverSettings:
    """The observer's settings from the FMU's parameter values, by name; the rest is the default."""
    full = {variable.name: variable.start for variable in PARAMETERS} | dict(values)
    clock = full["sensor.sample_time"], full["sensor.delay"], full["sensor.seed"]
    camera, rope = (
        Sensor(clock[0], full[f"{name}.noise"], full[f"{name}.bias"], clock[1], clock[2])
        for name in ("camera", "rope")
    )
    assumed = {name: full[f"observer.noise.{name}"] for name in vars(_NOISE)}
    return ObserverSettings(
        crane=believed_crane(full),
        speed=full["initial.speed"],
        model=full["observer.model"],
        elements=full["observer.elements"],
        mass_matrix=full["chain.mass_matrix"],
        sensor=full["observer.sensor"],
        inputs_at=full["observer.inputs_at"],
        noise=AssumedNoise(**assumed),
        camera=camera,
        rope=rope,
    )
