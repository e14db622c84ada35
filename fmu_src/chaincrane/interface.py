"""The FMUs' interface, in one table: variables, units, start values, ranges, meanings.

Both cranes have the same variables. A value reference is a variable's place in ``VARIABLES``. The
slaves, the model description, the driver and the README's table are all made from this.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from .crane import MATERIAL_POINTS
from .parameters import (
    MAX_ELEMENTS,
    SCHEMES,
    Chain,
    Crane,
    Damping,
    Initial,
    Numerics,
    Payload,
)

TINY = 2.2250738585072014e-308  # smallest normal number: the "above 0" of a closed range
QUARTER_TURN = 1.5707963267948963  # just below pi/2


@dataclass(frozen=True)
class Variable:
    """One row of the interface."""

    name: str
    causality: str  # input, parameter, output
    unit: str | None
    start: float | int | str | None  # None: calculated
    meaning: str
    kind: str = "Real"  # Real, Integer, String
    minimum: float | None = None
    maximum: float | None = None
    nominal: float | None = None


def _input(name: str, unit: str, meaning: str) -> Variable:
    return Variable(name, "input", unit, 0.0, meaning)


def _parameter(name: str, unit: str | None, start: float, meaning: str, **more: Any) -> Variable:
    return Variable(name, "parameter", unit, start, meaning, **more)


def _output(name: str, unit: str | None, meaning: str, **more: Any) -> Variable:
    return Variable(name, "output", unit, None, meaning, **more)


_CRANE, _INITIAL, _NUMERICS = Crane(), Initial(), Numerics()

INPUTS = (
    _input(
        "trolley.v_cmd",
        "m/s",
        "commanded velocity, held over the communication step; a change is a jump",
    ),
    _input(
        "trolley.a_cmd",
        "m/s2",
        "commanded acceleration, held over the communication step; the trolley moves at"
        " v_cmd + integral of a_cmd",
    ),
    _input("payload.fx", "N", "outer horizontal force on the payload (wind, a push)"),
)

PARAMETERS = (
    _parameter("chain.length", "m", _CRANE.chain.length, "unstretched length", minimum=TINY),
    _parameter("chain.mass", "kg", _CRANE.chain.mass, "mass of the whole chain", minimum=TINY),
    _parameter("chain.EA", "N", _CRANE.chain.EA, "axial stiffness E A", minimum=TINY, nominal=1e6),
    _parameter(
        "chain.elements",
        None,
        _NUMERICS.elements,
        "number of finite elements",
        kind="Integer",
        minimum=1,
        maximum=MAX_ELEMENTS,
    ),
    _parameter("payload.mass", "kg", _CRANE.payload.mass, "mass of the payload", minimum=TINY),
    _parameter("gravity", "m/s2", _CRANE.gravity, "gravity, downwards", minimum=TINY),
    _parameter(
        "damping.air",
        "1/s",
        _CRANE.damping.air,
        "mass-proportional damping of the absolute velocity, the air being at rest",
        minimum=0.0,
    ),
    _parameter(
        "damping.chain",
        "s",
        _CRANE.damping.chain,
        "axial Kelvin-Voigt time constant of the chain; no effect in the linear crane",
        minimum=0.0,
        nominal=1e-5,
    ),
    _parameter(
        "initial.speed",
        "m/s",
        _INITIAL.speed,
        "speed of the whole crane just before the start time; 0: at rest",
    ),
    _parameter(
        "initial.sway_angle",
        "rad",
        _INITIAL.sway_angle,
        "straight chain held at this angle, released at the start time",
        minimum=-QUARTER_TURN,
        maximum=QUARTER_TURN,
    ),
    _parameter(
        "solver.max_step",
        "s",
        _NUMERICS.max_step,
        "longest internal step; a communication step is divided evenly",
        minimum=TINY,
        nominal=1e-3,
    ),
    Variable(
        "solver.scheme",
        "parameter",
        None,
        _NUMERICS.scheme,
        f"time-stepping scheme of the nonlinear crane: {' or '.join(SCHEMES)} (the paper's);"
        " the linear crane steps exactly",
        kind="String",
    ),
)

OUTPUTS = (
    _output("trolley.x", "m", "travel since the start"),
    _output("trolley.v", "m/s", "velocity of the trolley"),
    _output(
        "trolley.fx",
        "N",
        "horizontal force that the drive exerts on the chain, without the impulses of jumps;"
        " nonlinear: mean of the last internal step",
    ),
    _output("payload.x", "m", "horizontal position, absolute"),
    _output("payload.y", "m", "height above the trolley's rail, so negative"),
    _output("payload.vx", "m/s", "horizontal velocity, absolute"),
    _output("payload.vy", "m/s", "vertical velocity"),
    _output("payload.x_rel", "m", "payload.x - trolley.x, the sway"),
    _output("payload.sway_angle", "rad", "of the line from trolley to payload"),
    _output("chain.mid_x_rel", "m", "the chain's middle point, relative to the trolley"),
    _output("chain.top_angle", "rad", "of the chain at the trolley: what a rope-angle sensor sees"),
    _output(
        "chain.tension_top",
        "N",
        "tension of the chain at the trolley; nonlinear: mean of the last internal step",
    ),
    _output(
        "chain.tension_min",
        "N",
        "smallest tension in the chain, likewise; below 0 it would be slack",
    ),
    *(
        _output(f"chain.x[{i}]", "m", f"material point at {i}/10 of the chain, absolute")
        for i in range(1, MATERIAL_POINTS + 1)
    ),
    *(
        _output(f"chain.y[{i}]", "m", f"material point at {i}/10 of the chain, height")
        for i in range(1, MATERIAL_POINTS + 1)
    ),
    _output("energy.total", "J", "mechanical energy above the rest position"),
    _output(
        "energy.dissipated", "J", "taken out since the start by damping and by the scheme itself"
    ),
    _output(
        "energy.error",
        "J",
        "energy + dissipated - work of trolley and payload force, since the start; ideally 0",
    ),
    _output("solver.steps", None, "internal steps of the last communication step", kind="Integer"),
    _output("solver.iterations", None, "iterations of the last communication step", kind="Integer"),
)

VARIABLES = INPUTS + PARAMETERS + OUTPUTS
NAMES = tuple(variable.name for variable in VARIABLES)

# The base units of FMI 2.0, as exponents: what each unit of the table is made of.
UNITS: Mapping[str, Mapping[str, int]] = {
    "m": {"m": 1},
    "m/s": {"m": 1, "s": -1},
    "m/s2": {"m": 1, "s": -2},
    "kg": {"kg": 1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "s": {"s": 1},
    "1/s": {"s": -1},
    "rad": {"rad": 1},
}


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
    numerics = Numerics(full["chain.elements"], full["solver.max_step"], full["solver.scheme"])
    return crane, initial, numerics
