"""The cranes' interface, in one table: variables, units, start values, ranges, meanings.

Both cranes have the same variables. A value reference is a variable's place in ``VARIABLES``. The
slaves, the model description, the C twins' header, the driver and docs/interface.md are all made
from this. Inputs and parameters stand with the dataclasses that the models read: Command, Crane,
Initial, Numerics. The layout of a crane's state, which its twin in C has too, stands below.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ..errors import BadValue
from ..variables import count, from_values, output, rows
from .command import Command
from .parameters import TOLERANCES_FROM, Crane, Initial, Numerics

MATERIAL_POINTS = 10  # of the chain that are outputs: chain.x[i], chain.y[i]

_WEIGHT = ("chain.mass", "chain.elements", "payload.mass", "gravity")
_STRETCH = ("chain.mass", "chain.EA", "payload.mass", "gravity")
_SHAPE = ("chain.length", *_STRETCH)
_INSIDE = (*_SHAPE, "chain.elements")  # of a point between the chain's ends
_SWAY = ("initial.sway_angle",)
_FORM = ("chain.formulation",)  # of a nonlinear crane
_SPEED = ("initial.speed",)
_DRAG = ("damping.air", *_SPEED)
_ENERGY = ("chain.length", "chain.mass", "payload.mass", "gravity", *_SWAY, *_SPEED)
_STRAIGHT = ("chain.length", *_SWAY)  # a string's displacement, which does not stretch


def _point(axis: str, place: int, meaning: str) -> Any:
    """Material point ``place``/10 of the chain; the last one is the payload."""
    inside = _SHAPE if place == MATERIAL_POINTS else _INSIDE
    return output(
        f"chain.{axis}[{place}]",
        "m",
        f"material point at {place}/{MATERIAL_POINTS} of the chain, {meaning}",
        starts_from=inside + _SWAY + _FORM,
        starts_from_linear=_STRAIGHT if axis == "x" else inside,
    )


INPUTS = rows(Command)
PARAMETERS = rows(Crane) + rows(Initial) + rows(Numerics)
OUTPUTS = (
    output("trolley.x", "m", "travel since the start"),
    output("trolley.v", "m/s", "velocity of the trolley", starts_from=_SPEED),
    output(
        "trolley.fx",
        "N",
        "horizontal force that the drive exerts on the chain, without the impulses of jumps;"
        " nonlinear: mean of the last internal step",
        starts_from=(*_WEIGHT, "chain.mass_matrix", *_DRAG, *_SWAY, *_FORM),
        starts_from_linear=(*_WEIGHT, "chain.mass_matrix", *_DRAG, *_SWAY),
    ),
    output(
        "trolley.impulse",
        "N.s",
        "of the drive on the chain, by the jump at the last communication step's start; 0: none",
    ),
    output(
        "payload.x",
        "m",
        "horizontal position, absolute",
        starts_from=_SHAPE + _SWAY + _FORM,
        starts_from_linear=_STRAIGHT,
    ),
    output(
        "payload.y",
        "m",
        "height above the trolley's rail, so negative",
        starts_from=_SHAPE + _SWAY + _FORM,
        starts_from_linear=_SHAPE,
    ),
    output("payload.vx", "m/s", "horizontal velocity, absolute", starts_from=_SPEED),
    output("payload.vy", "m/s", "vertical velocity"),
    output(
        "payload.x_rel",
        "m",
        "payload.x - trolley.x, the sway",
        starts_from=_SHAPE + _SWAY + _FORM,
        starts_from_linear=_STRAIGHT,
    ),
    output(
        "payload.sway_angle",
        "rad",
        "of the line from trolley to payload",
        starts_from=_SWAY,
        starts_from_linear=_STRETCH + _SWAY,
    ),
    output(
        "chain.mid_x_rel",
        "m",
        "the chain's middle point, relative to the trolley",
        starts_from=_INSIDE + _SWAY + _FORM,
        starts_from_linear=_STRAIGHT,
    ),
    output(
        "chain.top_angle",
        "rad",
        "of the chain at the trolley: what a rope-angle sensor sees",
        starts_from=_SWAY,
        starts_from_linear=(*_STRETCH, "chain.elements", *_SWAY),
    ),
    output(
        "chain.tension_top",
        "N",
        "tension of the chain at the trolley; nonlinear: mean of the last internal step, and after"
        " a jump without what vibrates faster than some 140 Hz along a stiff chain",
        starts_from=_WEIGHT + _SWAY + _FORM,
        starts_from_linear=_WEIGHT,
    ),
    output(
        "chain.tension_min",
        "N",
        "smallest tension in the chain, likewise; below 0 it would be slack",
        starts_from=_WEIGHT + _SWAY + _FORM,
        starts_from_linear=_WEIGHT,
    ),
    output(
        "chain.slack_time",
        "s",
        "time since the start in which an element was in compression; 0 in the linear crane; with"
        " chain.formulation = inextensible a value above 0 says that no real chain moves like that"
        " any more, and so does the log, once",
    ),
    *(_point("x", i, "absolute") for i in range(1, MATERIAL_POINTS + 1)),
    *(_point("y", i, "height") for i in range(1, MATERIAL_POINTS + 1)),
    output(
        "energy.total",
        "J",
        "mechanical energy above the rest position",
        starts_from=(*_ENERGY, "chain.EA", "chain.elements", *_FORM),
        starts_from_linear=_ENERGY,
    ),
    output(
        "energy.dissipated",
        "J",
        "taken out since the start by damping and by the scheme itself; can dip by what the scheme"
        " gives back",
    ),
    output(
        "energy.error",
        "J",
        "energy + dissipated - work of trolley and payload force, since the start; ideally 0. It"
        " does not see the time error",
    ),
    output(
        "error.payload",
        "m",
        "estimated time error of the payload's place, the largest since the start, if"
        " solver.error_estimate or solver.tolerance is on; linear: 0, it is exact",
    ),
    output("error.tension_top", "N", "the same of chain.tension_top"),
    output("error.trolley_fx", "N", "the same of trolley.fx"),
    count(
        "error.predictable",
        "0 since error.payload has exceeded 0.005 of the chain's length, the error itself perhaps"
        " several times that: the motion is one that no step of this size predicts; else 1",
    ),
    count("solver.steps", "internal steps of the last communication step, with a companion's"),
    count("solver.iterations", "iterations of the last communication step, with a companion's"),
)

VARIABLES = INPUTS + PARAMETERS + OUTPUTS
NAMES = tuple(variable.name for variable in VARIABLES)


EXPERIMENT_TOLERANCE_ALLOWED = (
    "above 0 and below 1, as solver.tolerance_from = experiment asks for it"
)


def settings(
    values: Mapping[str, Any], experiment: float | None = None
) -> tuple[Crane, Initial, Numerics]:
    """A crane's parameters from the FMU's parameter values, by name; the rest is the default.

    ``experiment``: tolerance of the host's experiment, of the chain's length; None: it has none.
    Raises BadValue where the parameters ask for it and it is not one.
    """
    crane, initial = from_values(Crane, values), from_values(Initial, values)
    numerics = from_values(Numerics, values)
    if numerics.tolerance_from == TOLERANCES_FROM[1]:
        if experiment is None or not 0.0 < experiment < 1.0:
            raise BadValue("tolerance of the experiment", experiment, EXPERIMENT_TOLERANCE_ALLOWED)
        numerics = replace(numerics, tolerance=experiment * crane.chain.length)
    return crane, initial, numerics


# What is said, once, when the tension of an inextensible chain falls below 0.
NO_SLACK = (
    "the tension has fallen below 0: from here on a real chain would be slack, which"
    " chain.formulation = inextensible cannot be; chain.slack_time counts"
)
# What is said, once, when error.predictable falls to 0.
NOT_PREDICTABLE = (
    "error.payload has exceeded 0.005 of chain.length: the motion is not predictable from here on,"
    " a shorter solver.max_step gives another one"
)

# What is said, once, when solver.tolerance is not kept.
TOLERANCE_NOT_KEPT = (
    "error.payload exceeds solver.tolerance from here on: steps are as short as they can be made,"
    " or more communication steps have been made than can be run anew"
)

# A state is one vector of doubles: these numbers first, by name, with their units; then arrays.
SHARED_STATE = {
    "time": "s, since the start",
    "trolley_x": "m",
    "trolley_v": "m/s",
    "trolley_gained": "m/s, integral of a_cmd since the start",
    "steps": "internal steps of the last communication step",
    "iterations": "its iterations",
    "ledger_start": "J, energy at the start",
    "ledger_trolley": "J, work of the trolley since",
    "ledger_payload": "J, work of the payload's force since",
    "ledger_dissipated": "J, taken out since",
    "trolley_impulse": "N s, of the jump at the last communication step's start",
}
LAST_COMMAND = "last_command."  # before the name of a command's field
NONLINEAR_STATE = {
    **SHARED_STATE,
    "loaded": "1: the last command is known, 0: the next step is a new start for the scheme",
    **{f"{LAST_COMMAND}{row.symbol}": f"{row.unit}, of the last step, if loaded" for row in INPUTS},
    "last_h": "s, internal step, if elements have stretched in it",
    "energy": "J",
    "scale": "J, what errors of energy are measured against",
    "trolley_fx": "N",
    "slack_time": "s, since the start",
    "waves": "s, for which steps still have to resolve the waves of a jump",
    "error_payload": "m, estimated time error, the largest since the start",
    "error_tension_top": "N, the same",
    "error_trolley_fx": "N, the same",
}
# After the nonlinear crane's own, where solver.tolerance is on; then the steps remembered.
TOLERANCE_STATE = {
    "level": "times that solver.max_step was halved",
    "gave_up": "1: no run with shorter steps can be made any more",
    "remembered": "communication steps since the start, which can be run anew",
}
PAST_STEP = {
    "h": "s, its length",
    **{row.symbol: row.unit or "" for row in INPUTS},
    "trolley_v": "m/s, before it",
    "trolley_gained": "m/s, before it",
}
LINEAR_STATE = {**SHARED_STATE, "trolley_fx": "N"}
