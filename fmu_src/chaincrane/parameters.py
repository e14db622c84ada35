"""Parameters of the cranes, and the parameter sets of the paper.

The attribute paths are the FMU's variable names: ``parameters.chain.EA`` is ``chain.EA``.
Physics (:class:`Crane`), the state at the start (:class:`Initial`) and numerical settings
(:class:`Numerics`) stand apart.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, is_dataclass
from math import isfinite
from typing import Any

from .errors import BadValue

MAX_ELEMENTS = 10_000
MATERIAL_POINTS = 10  # of the chain that are outputs: chain.x[i], chain.y[i]
SCHEMES = ("energy_momentum", "newmark")
MASS_MATRICES = ("consistent", "averaged")
CHOICES = {"solver.scheme": SCHEMES, "chain.mass_matrix": MASS_MATRICES}


@dataclass(frozen=True)
class Chain:
    """The chain. The paper gives length and mass; its EA is open, ours is a steel rod's.

    EA = E m / (rho L) with E = 210 GPa and rho = 7850 kg/m3.
    """

    length: float = 0.8  # m, unstretched
    mass: float = 0.22  # kg, the whole chain
    EA: float = 7.357e6  # N, axial stiffness


@dataclass(frozen=True)
class Payload:
    """A point mass at the chain's lower end."""

    mass: float = 0.42  # kg


@dataclass(frozen=True)
class Damping:
    """Damping, ours: the paper has none."""

    air: float = 0.0  # 1/s, mass-proportional, on the absolute velocity
    chain: float = 0.0  # s, axial Kelvin-Voigt time constant


@dataclass(frozen=True)
class Crane:
    """The physics of a crane."""

    chain: Chain = field(default_factory=Chain)
    payload: Payload = field(default_factory=Payload)
    gravity: float = 9.81  # m/s2
    damping: Damping = field(default_factory=Damping)


@dataclass(frozen=True)
class Initial:
    """The crane's motion just before the start time."""

    speed: float = 0.8  # m/s, of the whole crane
    sway_angle: float = 0.0  # rad, of the straight chain, released at the start time


@dataclass(frozen=True)
class Numerics:
    """Numerical settings."""

    elements: int = 10  # number of finite elements
    max_step: float = 1e-3  # s, longest internal step
    scheme: str = "energy_momentum"  # or "newmark", the paper's
    mass_matrix: str = "consistent"  # the paper's, or "averaged", ours


# Maourane & Szabo (2020), section 2.3; the stiffness is ours, the paper gives none.
MAOURANE_SZABO_2020_HEAVY = Crane(payload=Payload(mass=0.42))
MAOURANE_SZABO_2020_LIGHT = Crane(payload=Payload(mass=0.07))

_POSITIVE = "a finite number above 0"
_NOT_NEGATIVE = "a finite number, 0 or above"
_FINITE = "a finite number"
_QUARTER_TURN = 1.5707963267948966

_NUMBERS = {  # name -> (allowed, in words; test)
    "chain.length": (_POSITIVE, lambda v: v > 0),
    "chain.mass": (_POSITIVE, lambda v: v > 0),
    "chain.EA": (_POSITIVE, lambda v: v > 0),
    "payload.mass": (_POSITIVE, lambda v: v > 0),
    "gravity": (_POSITIVE, lambda v: v > 0),
    "damping.air": (_NOT_NEGATIVE, lambda v: v >= 0),
    "damping.chain": (_NOT_NEGATIVE, lambda v: v >= 0),
    "initial.speed": (_FINITE, lambda v: True),
    "initial.sway_angle": (
        "an angle strictly between -pi/2 and pi/2 rad",
        lambda v: abs(v) < _QUARTER_TURN,
    ),
}


def allowed(name: str) -> str:
    """What a parameter may be, in words; ``name`` is the FMU's."""
    if name in CHOICES:
        return "one of " + ", ".join(CHOICES[name])
    if name == "chain.elements":
        return f"a whole number from 1 to {MAX_ELEMENTS}"
    return _POSITIVE if name == "solver.max_step" else _NUMBERS[name][0]


def checked() -> tuple[str, ...]:
    """Names of the parameters in the order in which :func:`check` looks at them."""
    return (*_NUMBERS, "chain.elements", "solver.max_step", *CHOICES)


def check_number(name: str, value: float, allowed: str = _FINITE, *, test: Any = None) -> None:
    """Raise BadValue unless ``value`` is a finite number that passes ``test``."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise BadValue(name, value, allowed)
    if not isfinite(value) or (test is not None and not test(value)):
        raise BadValue(name, value, allowed)


def _check_fields(group: Any, prefix: str) -> None:
    for entry in fields(group):
        name, value = prefix + entry.name, getattr(group, entry.name)
        if is_dataclass(value):
            _check_fields(value, name + ".")
        else:
            words, test = _NUMBERS[name]
            check_number(name, value, words, test=test)


def _stiffest(crane: Crane, elements: int) -> float:
    """EA, N, whose tension moves by a thousandth of the weight with a position's last digit.

    That digit, 2e-16 of the length, is a force of 2e-16 n EA in an element.
    """
    weight = crane.gravity * (crane.chain.mass + crane.payload.mass)
    return 1e-3 * weight / (2e-16 * elements)


def check(crane: Crane, initial: Initial, numerics: Numerics) -> None:
    """Raise BadValue for the first value that is not allowed; names are the FMU's."""
    _check_fields(crane, "")
    _check_fields(initial, "initial.")
    elements = numerics.elements
    if not isinstance(elements, int) or not 1 <= elements <= MAX_ELEMENTS:
        raise BadValue("chain.elements", elements, allowed("chain.elements"))
    stiffest = _stiffest(crane, elements)
    if stiffest < crane.chain.EA:
        words = f"at most {stiffest:.3g} N: beyond, round-off outweighs these masses and elements"
        raise BadValue("chain.EA", crane.chain.EA, words)
    check_number("solver.max_step", numerics.max_step, _POSITIVE, test=lambda v: v > 0)
    for name, value in (
        ("solver.scheme", numerics.scheme),
        ("chain.mass_matrix", numerics.mass_matrix),
    ):
        if value not in CHOICES[name]:
            raise BadValue(name, value, allowed(name))
