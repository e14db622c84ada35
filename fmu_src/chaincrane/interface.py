"""The cranes' interface, in one table: variables, units, start values, ranges, meanings.

Both cranes have the same variables. A value reference is a variable's place in ``VARIABLES``. The
slaves, the model description, the driver and the README's table are all made from this.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .parameters import (
    MATERIAL_POINTS,
    MAX_ELEMENTS,
    SCHEMES,
    Chain,
    Crane,
    Damping,
    Initial,
    Numerics,
    Payload,
)
from .variables import TINY, input_variable, output, parameter

QUARTER_TURN = 1.5707963267948963  # just below pi/2

_CRANE, _INITIAL, _NUMERICS = Crane(), Initial(), Numerics()

INPUTS = (
    input_variable(
        "trolley.v_cmd",
        "m/s",
        "commanded velocity, held over the communication step; a change is a jump",
    ),
    input_variable(
        "trolley.a_cmd",
        "m/s2",
        "commanded acceleration, held over the communication step; the trolley moves at"
        " v_cmd + integral of a_cmd",
    ),
    input_variable("payload.fx", "N", "outer horizontal force on the payload (wind, a push)"),
)

PARAMETERS = (
    parameter("chain.length", "m", _CRANE.chain.length, "unstretched length", minimum=TINY),
    parameter("chain.mass", "kg", _CRANE.chain.mass, "mass of the whole chain", minimum=TINY),
    parameter("chain.EA", "N", _CRANE.chain.EA, "axial stiffness E A", minimum=TINY, nominal=1e6),
    parameter(
        "chain.elements",
        None,
        _NUMERICS.elements,
        "number of finite elements",
        kind="Integer",
        minimum=1,
        maximum=MAX_ELEMENTS,
    ),
    parameter("payload.mass", "kg", _CRANE.payload.mass, "mass of the payload", minimum=TINY),
    parameter("gravity", "m/s2", _CRANE.gravity, "gravity, downwards", minimum=TINY),
    parameter(
        "damping.air",
        "1/s",
        _CRANE.damping.air,
        "mass-proportional damping of the absolute velocity, the air being at rest",
        minimum=0.0,
    ),
    parameter(
        "damping.chain",
        "s",
        _CRANE.damping.chain,
        "axial Kelvin-Voigt time constant of the chain; no effect in the linear crane",
        minimum=0.0,
        nominal=1e-5,
    ),
    parameter(
        "initial.speed",
        "m/s",
        _INITIAL.speed,
        "speed of the whole crane just before the start time; 0: at rest",
    ),
    parameter(
        "initial.sway_angle",
        "rad",
        _INITIAL.sway_angle,
        "straight chain held at this angle, released at the start time",
        minimum=-QUARTER_TURN,
        maximum=QUARTER_TURN,
    ),
    parameter(
        "solver.max_step",
        "s",
        _NUMERICS.max_step,
        "longest internal step; a communication step is divided evenly",
        minimum=TINY,
        nominal=1e-3,
    ),
    parameter(
        "solver.scheme",
        None,
        _NUMERICS.scheme,
        f"time-stepping scheme of the nonlinear crane: {' or '.join(SCHEMES)} (the paper's);"
        " the linear crane steps exactly",
        kind="String",
    ),
    parameter(
        "chain.mass_matrix",
        None,
        _NUMERICS.mass_matrix,
        "mass matrix of an element: consistent (the paper's) or averaged with the lumped one, which"
        " halves the mesh's error or better",
        kind="String",
    ),
)

OUTPUTS = (
    output("trolley.x", "m", "travel since the start"),
    output("trolley.v", "m/s", "velocity of the trolley"),
    output(
        "trolley.fx",
        "N",
        "horizontal force that the drive exerts on the chain, without the impulses of jumps;"
        " nonlinear: mean of the last internal step",
    ),
    output("payload.x", "m", "horizontal position, absolute"),
    output("payload.y", "m", "height above the trolley's rail, so negative"),
    output("payload.vx", "m/s", "horizontal velocity, absolute"),
    output("payload.vy", "m/s", "vertical velocity"),
    output("payload.x_rel", "m", "payload.x - trolley.x, the sway"),
    output("payload.sway_angle", "rad", "of the line from trolley to payload"),
    output("chain.mid_x_rel", "m", "the chain's middle point, relative to the trolley"),
    output("chain.top_angle", "rad", "of the chain at the trolley: what a rope-angle sensor sees"),
    output(
        "chain.tension_top",
        "N",
        "tension of the chain at the trolley; nonlinear: mean of the last internal step",
    ),
    output(
        "chain.tension_min",
        "N",
        "smallest tension in the chain, likewise; below 0 it would be slack",
    ),
    *(
        output(f"chain.x[{i}]", "m", f"material point at {i}/10 of the chain, absolute")
        for i in range(1, MATERIAL_POINTS + 1)
    ),
    *(
        output(f"chain.y[{i}]", "m", f"material point at {i}/10 of the chain, height")
        for i in range(1, MATERIAL_POINTS + 1)
    ),
    output("energy.total", "J", "mechanical energy above the rest position"),
    output(
        "energy.dissipated", "J", "taken out since the start by damping and by the scheme itself"
    ),
    output(
        "energy.error",
        "J",
        "energy + dissipated - work of trolley and payload force, since the start; ideally 0",
    ),
    output(
        "solver.steps",
        None,
        "internal steps of the last communication step",
        kind="Integer",
        minimum=0,
    ),
    output(
        "solver.iterations",
        None,
        "iterations of the last communication step",
        kind="Integer",
        minimum=0,
    ),
)

VARIABLES = INPUTS + PARAMETERS + OUTPUTS
NAMES = tuple(variable.name for variable in VARIABLES)


def settings(values: Mapping[str, Any]) -> tuple[Crane, Initial, Numerics]:
    """A crane's parameters from the FMU's parameter values, by name; the rest is the default."""
    full = {variable.name: variable.start for variable in PARAMETERS} | dict(values)
    crane = Crane(
        chain=Chain(full["chain.length"], full["chain.mass"], full["chain.EA"]),
        payload=Payload(full["payload.mass"]),
        gravity=full["gravity"],
        damping=Damping(full["damping.air"], full["damping.chain"]),
    )
    initial = Initial(full["initial.speed"], full["initial.sway_angle"])
    numerics = Numerics(
        full["chain.elements"],
        full["solver.max_step"],
        full["solver.scheme"],
        full["chain.mass_matrix"],
    )
    return crane, initial, numerics
