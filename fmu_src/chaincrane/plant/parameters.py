"""Parameters of the cranes, each with its row of the interface, and the paper's parameter sets.

Physics (:class:`Crane`), the motion at the start (:class:`Initial`) and numerical settings
(:class:`Numerics`) stand apart. Each field carries the FMU variable that sets it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from ..errors import BadValue
from ..variables import ABOVE_ZERO, check_rows, choice, parameter, row_of, whole

_MAX_ELEMENTS = 10_000
MAX_POINTS = 40  # Gauss points of an inextensible chain, whose matrices are full
MAX_MASS_RATIO = 1e6  # of payload to chain there: the steps get short by its root
SCHEMES = ("energy_momentum", "newmark")
MASS_MATRICES = ("consistent", "averaged")
FORMULATIONS = ("truss", "inextensible")
ERROR_ESTIMATES = ("off", "companion")
TOLERANCES_FROM = ("parameter", "experiment")
_HALF_TURN = 3.1415926535897927  # rad, just below pi
LAST_DIGIT = 2e-16  # of the length: a position's last digit
UNSTEADY = 1e-3  # of the weight: what that digit may move a tension by


@dataclass(frozen=True)
class Chain:
    """The chain. The paper gives length and mass; its EA is open, ours is a steel rod's.

    EA = E m / (rho L) with E = 210 GPa and rho = 7850 kg/m3.
    """

    length: float = parameter("chain.length", "m", 0.8, "unstretched length", minimum=ABOVE_ZERO)
    mass: float = parameter("chain.mass", "kg", 0.22, "mass of the whole chain", minimum=ABOVE_ZERO)
    EA: float = parameter(
        "chain.EA", "N", 7.357e6, "axial stiffness E A", minimum=ABOVE_ZERO, nominal=1e6
    )


@dataclass(frozen=True)
class Payload:
    """A point mass at the chain's lower end."""

    mass: float = parameter("payload.mass", "kg", 0.42, "mass of the payload", minimum=ABOVE_ZERO)


@dataclass(frozen=True)
class Damping:
    """Damping, ours: the paper has none."""

    air: float = parameter(
        "damping.air",
        "1/s",
        0.0,
        "mass-proportional damping of the absolute velocity, the air being at rest",
        minimum=0.0,
    )
    chain: float = parameter(
        "damping.chain",
        "s",
        0.0,
        "axial Kelvin-Voigt time constant of the chain; no effect in the linear crane",
        minimum=0.0,
        nominal=1e-5,
    )


@dataclass(frozen=True)
class Crane:
    """The physics of a crane."""

    chain: Chain = field(default_factory=Chain)
    payload: Payload = field(default_factory=Payload)
    gravity: float = parameter("gravity", "m/s2", 9.81, "gravity, downwards", minimum=ABOVE_ZERO)
    damping: Damping = field(default_factory=Damping)

    @property
    def total_mass(self) -> float:
        """Chain and payload, kg."""
        return self.chain.mass + self.payload.mass


@dataclass(frozen=True)
class Initial:
    """The crane's motion just before the start time."""

    speed: float = parameter(
        "initial.speed",
        "m/s",
        0.8,
        "speed of the whole crane just before the start time; 0: at rest",
    )
    sway_angle: float = parameter(
        "initial.sway_angle",
        "rad",
        0.0,
        "straight chain held at this angle, released at the start time; beyond pi/2 it stands on"
        " the trolley, in compression",
        minimum=-_HALF_TURN,
        maximum=_HALF_TURN,
        words="an angle strictly between -pi and pi rad",
    )


@dataclass(frozen=True)
class Numerics:
    """Numerical settings."""

    elements: int = whole(
        "chain.elements", 10, (1, _MAX_ELEMENTS), "number of finite elements; of Gauss points"
    )
    max_step: float = parameter(
        "solver.max_step",
        "s",
        1e-3,
        "longest internal step; a communication step is divided evenly. Shorter ones follow the"
        " waves that a jump of the trolley sends along a soft chain",
        minimum=ABOVE_ZERO,
        nominal=1e-3,
    )
    scheme: str = choice(
        "solver.scheme",
        SCHEMES[0],
        SCHEMES,
        f"time-stepping scheme of the nonlinear crane: {' or '.join(SCHEMES)} (the paper's);"
        " the linear crane steps exactly",
    )
    mass_matrix: str = choice(
        "chain.mass_matrix",
        MASS_MATRICES[0],
        MASS_MATRICES,
        "mass matrix of an element: consistent (the paper's) or averaged with the lumped one, the"
        " rotation of the whole kept exact: half the payload's error by the mesh or less for the"
        " paper's payloads and ten elements, little less for a payload that is light beside the"
        " chain",
    )
    formulation: str = choice(
        "chain.formulation",
        FORMULATIONS[0],
        FORMULATIONS,
        "nonlinear crane: the paper's truss, or inextensible: a smooth chain that can neither"
        " stretch nor be slack, with at most 40 chain.elements; chain.EA, damping.chain,"
        " chain.mass_matrix and solver.scheme have no effect then",
    )
    error_estimate: str = choice(
        "solver.error_estimate",
        ERROR_ESTIMATES[0],
        ERROR_ESTIMATES,
        "companion: a second solution with steps twice as long tells the time error, for half the"
        " cost again or more; an even number of internal steps is taken then",
    )
    tolerance: float = parameter(
        "solver.tolerance",
        "m",
        0.0,
        "of the payload's place in time: a companion is carried along; where error.payload comes"
        " to half of it, all since the start is run anew with steps half as long, down to a"
        " sixty-fourth of solver.max_step; 0: off. The linear crane is exact without",
        minimum=0.0,
        nominal=1e-4,
    )
    tolerance_from: str = choice(
        "solver.tolerance_from",
        TOLERANCES_FROM[0],
        TOLERANCES_FROM,
        "parameter: solver.tolerance; experiment: the tolerance of the host's experiment, of the"
        " chain's length",
    )

    @property
    def compares(self) -> bool:
        """Whether a companion is carried along."""
        return self.error_estimate != ERROR_ESTIMATES[0] or self.tolerance > 0.0


# Maourane & Szabo (2020), section 2.3; the stiffness is ours, the paper gives none.
MAOURANE_SZABO_2020_HEAVY = Crane(payload=Payload(mass=0.42))
MAOURANE_SZABO_2020_LIGHT = Crane(payload=Payload(mass=0.07))


def _stiffest(crane: Crane, elements: int) -> float:
    """EA, N, whose tension moves by a thousandth of the weight with a position's last digit.

    That digit, 2e-16 of the length, is a force of 2e-16 n EA in an element.
    """
    weight = crane.gravity * crane.total_mass
    return UNSTEADY * weight / (LAST_DIGIT * elements)


def check(crane: Crane, initial: Initial, numerics: Numerics) -> None:
    """Raise BadValue for the first value that is not allowed; names are the FMU's."""
    check_rows(crane)
    check_rows(initial)
    row_of(Numerics, "elements").check(numerics.elements)
    stiffest = _stiffest(crane, numerics.elements)
    truss = numerics.formulation == FORMULATIONS[0]
    if truss and stiffest < crane.chain.EA:
        words = f"at most {stiffest:.3g} N: beyond, round-off outweighs these masses and elements"
        raise BadValue("chain.EA", crane.chain.EA, words)
    check_rows(numerics)
    if not truss:
        _check_inextensible(crane, numerics)


def _check_inextensible(crane: Crane, numerics: Numerics) -> None:
    """Raise BadValue for what chain.formulation = inextensible does not take."""
    words = "with chain.formulation = inextensible"
    if numerics.elements > MAX_POINTS:
        raise BadValue("chain.elements", numerics.elements, f"at most {MAX_POINTS} {words}")
    most = MAX_MASS_RATIO * crane.chain.mass
    if crane.payload.mass > most:
        raise BadValue("payload.mass", crane.payload.mass, f"at most {most:.3g} kg {words}")
