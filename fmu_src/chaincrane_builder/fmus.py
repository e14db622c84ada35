"""The FMUs that there are, and what is told of each."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from chaincrane.control import antisway_interface, observer_interface
from chaincrane.plant import interface
from chaincrane.variables import Variable

_HERE = Path(__file__).resolve().parent
_IN_WHEEL = (_HERE / "fmu_src").exists()
SOURCES = _HERE / "fmu_src" if _IN_WHEEL else _HERE.parent
LICENCE = _HERE / "LICENSE" if _IN_WHEEL else SOURCES.parent / "LICENSE"
NATIVE = "_native"  # ends the names of FMUs that are all C


@dataclass(frozen=True)
class Fmu:
    """What is told of one FMU."""

    description: str
    variables: tuple[Variable, ...]
    page: str = "index.html"  # its documentation, in the documentation folder
    packages: tuple[str, ...] = ()  # that its Python needs
    linear: bool = False  # its outputs start from what a linear crane's do
    kernel: str | None = None  # C file of the crane that it loads as a library
    crane: str | None = None  # of a native FMU: C file of its crane

    @property
    def outputs(self) -> list[Variable]:
        """The interface's outputs."""
        return [variable for variable in self.variables if variable.causality == "output"]

    def starts_from(self, output: Variable) -> tuple[str, ...]:
        """Parameters that an output depends on before the first step."""
        if self.linear and output.starts_from_linear is not None:
            return output.starts_from_linear
        return output.starts_from


_NONLINEAR = (
    "Overhead crane with a flexible chain: nonlinear, truss finite elements"
    " (Maourane & Szabo 2020, section 2.1)"
)
_LINEAR = (
    "Overhead crane with a flexible chain: linear, a taut string stepped exactly"
    " (Maourane & Szabo 2020, section 2.2)"
)
_IN_C = "; native, no Python inside"

FMUS = {
    "crane_nl": Fmu(_NONLINEAR, interface.VARIABLES, kernel="tolerance.c"),
    "crane_lin": Fmu(_LINEAR, interface.VARIABLES, packages=("NumPy",), linear=True),
    "crane_observer": Fmu(
        "Observer of an overhead crane's chain and payload: a steady-state Kalman filter on the"
        " string's modes, from a camera or a rope-angle sensor",
        observer_interface.VARIABLES,
        "control.html",
        ("NumPy", "SciPy"),
    ),
    "crane_antisway": Fmu(
        "Anti-sway controller of an overhead crane: a plan and a regulator about it, or an"
        " open-loop move, within limits of velocity and acceleration",
        antisway_interface.VARIABLES,
        "control.html",
        ("NumPy", "SciPy"),
    ),
    "crane_nl_native": Fmu(_NONLINEAR + _IN_C, interface.VARIABLES, crane="tolerance.c"),
    "crane_lin_native": Fmu(_LINEAR + _IN_C, interface.VARIABLES, linear=True, crane="linear.c"),
}
MODELS = tuple(name for name, fmu in FMUS.items() if fmu.crane is None)
NATIVE_MODELS = tuple(name for name, fmu in FMUS.items() if fmu.crane is not None)
