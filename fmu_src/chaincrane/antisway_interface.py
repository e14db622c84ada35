"""The anti-sway controller's interface, in one table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from . import interface
from .antisway import METHODS, AntiSwaySettings, Limits, Scales
from .observer import INPUTS_AT, SHOWN_MODES
from .observer_interface import BELIEVED, believed_crane, design_model
from .variables import TINY, input_variable, output, parameter

_SETTINGS = AntiSwaySettings()
_SHARED = {variable.name: variable for variable in interface.VARIABLES}

INPUTS = (
    input_variable("target.x", "m", "where the trolley is to go"),
    input_variable("trolley.x", "m", "where it is"),
    input_variable("trolley.v", "m/s", "how fast it goes"),
    *(
        input_variable(f"mode.x_rel[{i}]", "m", f"estimated share of mode {i} in payload.x_rel")
        for i in range(1, SHOWN_MODES + 1)
    ),
    *(
        input_variable(f"mode.vx_rel[{i}]", "m/s", f"estimated share of mode {i} in payload.vx_rel")
        for i in range(1, SHOWN_MODES + 1)
    ),
)

PARAMETERS = (
    *(_SHARED[name] for name in BELIEVED),
    parameter(
        "antisway.method",
        None,
        _SETTINGS.method,
        f"{', '.join(METHODS)}: state feedback, or open loop a move shaped against sway (zero"
        " vibration) or the plain fastest move",
        kind="String",
    ),
    *design_model("antisway", _SETTINGS.model, _SETTINGS.elements),
    parameter(
        "antisway.modes",
        None,
        _SETTINGS.modes,
        "number of modes that lqr feeds back",
        kind="Integer",
        minimum=1,
        maximum=SHOWN_MODES,
    ),
    parameter(
        "antisway.inputs_at",
        None,
        _SETTINGS.inputs_at,
        f"{' or '.join(INPUTS_AT)} of the communication step: when the estimate is true; lqr"
        " predicts one of the start to the end, where its command begins",
        kind="String",
    ),
    parameter(
        "antisway.scale.position",
        "m",
        _SETTINGS.scales.position,
        "lqr: deviation of the trolley that weighs like the other scales",
        minimum=TINY,
        nominal=0.1,
    ),
    parameter(
        "antisway.scale.sway",
        "m",
        _SETTINGS.scales.sway,
        "lqr: sway of the payload that weighs like the other scales",
        minimum=TINY,
        nominal=0.1,
    ),
    parameter(
        "antisway.scale.acceleration",
        "m/s2",
        _SETTINGS.scales.acceleration,
        "lqr: acceleration of the trolley that weighs like the other scales",
        minimum=TINY,
    ),
    parameter(
        "limit.velocity",
        "m/s",
        _SETTINGS.limits.velocity,
        "largest speed of the trolley",
        minimum=TINY,
    ),
    parameter(
        "limit.acceleration",
        "m/s2",
        _SETTINGS.limits.acceleration,
        "largest acceleration of the trolley",
        minimum=TINY,
    ),
)

OUTPUTS = (
    output("trolley.a_cmd", "m/s2", "commanded acceleration, for the next communication step"),
)

VARIABLES = INPUTS + PARAMETERS + OUTPUTS


def settings(values: Mapping[str, Any]) -> AntiSwaySettings:
    """The settings from the FMU's parameter values, by name; the rest is the default."""
    full = {variable.name: variable.start for variable in PARAMETERS} | dict(values)
    return AntiSwaySettings(
        crane=believed_crane(full),
        method=full["antisway.method"],
        model=full["antisway.model"],
        elements=full["antisway.elements"],
        mass_matrix=full["chain.mass_matrix"],
        modes=full["antisway.modes"],
        inputs_at=full["antisway.inputs_at"],
        limits=Limits(full["limit.velocity"], full["limit.acceleration"]),
        scales=Scales(**{name: full[f"antisway.scale.{name}"] for name in vars(_SETTINGS.scales)}),
    )
