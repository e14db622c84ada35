"""The observer's interface, in one table: its inputs and settings, and its outputs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..plant import interface
from ..plant.interface import MATERIAL_POINTS
from ..variables import Variable, count, from_values, output, rows
from .design import CRANE_ROWS, MASS_MATRIX, SHOWN_MODES, design_rows
from .observer import ObserverInput, ObserverSettings

_CRANES = {variable.name: variable for variable in interface.OUTPUTS}


def _estimate(name: str) -> Variable:
    """The estimate of a crane's output: before a sample is heard, of a crane below its trolley."""
    row = _CRANES[name]
    starts_from = row.starts_from if name in ("trolley.v", "payload.vx") else ()
    return output(name, row.unit, row.meaning, starts_from=starts_from)


INPUTS = rows(ObserverInput)
PARAMETERS = design_rows(ObserverSettings)

_BELIEVED = (*(row.name for row in CRANE_ROWS), MASS_MATRIX.name)
_FILTER = tuple(
    row.name
    for row in PARAMETERS
    if row.name.startswith("observer.") and row.name != "observer.inputs_at"
)
_STD = (*_BELIEVED, "sensor.sample_time", *_FILTER)

OUTPUTS = (
    *map(_estimate, ("trolley.x", "trolley.v", "payload.x", "payload.vx", "payload.x_rel")),
    output("payload.vx_rel", "m/s", "payload.vx - trolley.v"),
    *map(_estimate, ("payload.sway_angle", "chain.mid_x_rel", "chain.top_angle")),
    *(_estimate(f"chain.x[{i}]") for i in range(1, MATERIAL_POINTS + 1)),
    *(
        output(f"mode.x_rel[{i}]", "m", f"share of mode {i} in payload.x_rel, to feed back")
        for i in range(1, SHOWN_MODES + 1)
    ),
    *(
        output(f"mode.vx_rel[{i}]", "m/s", f"share of mode {i} in payload.vx_rel, to feed back")
        for i in range(1, SHOWN_MODES + 1)
    ),
    output("wind.fx", "N", "steady force on the payload; 0 unless observer.offset = wind"),
    output("camera.innovation", "m", "last sample less what was expected; 0 with the other sensor"),
    output("rope.innovation", "rad", "last sample less what was expected; 0 with the other sensor"),
    output("camera.bias_found", "m", "bias of the camera; 0 unless observer.offset = bias"),
    output("rope.bias_found", "rad", "bias of the rope sensor; 0 unless observer.offset = bias"),
    *(
        output(
            f"std.{name}",
            unit,
            f"standard deviation of {name}'s error, in the steady state",
            starts_from=_STD,
        )
        for name, unit in (
            ("payload.x_rel", "m"),
            ("payload.vx_rel", "m/s"),
            ("chain.mid_x_rel", "m"),
            ("chain.top_angle", "rad"),
            ("wind.fx", "N"),
            ("camera.bias_found", "m"),
            ("rope.bias_found", "rad"),
        )
    ),
    count("sensor.samples", "samples used since the start"),
    count("sensor.left_out", "samples that the gate has left out since the start"),
)

VARIABLES = INPUTS + PARAMETERS + OUTPUTS


def settings(values: Mapping[str, Any]) -> ObserverSettings:
    """The observer's settings from the FMU's parameter values, by name; the rest is the default."""
    return from_values(ObserverSettings, values)
