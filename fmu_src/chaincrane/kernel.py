"""The nonlinear crane, stepped by the C kernel: what NonlinearCrane does, at the speed of C.

The NumPy model in ``nonlinear.py`` is the definition; ``native/chain_kernel.c`` has the same
equations under the same names. Nothing here needs NumPy, so that a start is light.
"""

from __future__ import annotations

import ctypes
import os
import sys
from typing import Any

from .errors import BadState, CraneError, EnergyBalanceBroken, NotConverged
from .interface import OUTPUTS
from .ledger import Effort, Ledger
from .parameters import MASS_MATRICES, SCHEMES, Crane, Initial, Numerics, check
from .trolley import Trolley, checked_move

KERNEL_VERSION = 3  # CHAIN_KERNEL_VERSION of the header that the structures below mirror
_OK, _NOT_CONVERGED, _SINGULAR, _STEP_ENERGY, _TOTAL_ENERGY, _BAD_VALUE = range(6)
_HEADER = 17  # doubles of the state before its arrays, in the order of CraneModel.save()
_PLATFORMS = {
    "linux": ("linux64", "so"),
    "win32": ("win64", "dll"),
    "darwin": ("darwin64", "dylib"),
}


class KernelMissing(CraneError):
    """No compiled kernel fits this host."""


class _Settings(ctypes.Structure):
    _fields_ = [
        *(
            (name, ctypes.c_double)
            for name in (
                "length",
                "mass",
                "EA",
                "payload_mass",
                "gravity",
                "damping_air",
                "damping_chain",
                "speed",
                "sway_angle",
                "max_step",
            )
        ),
        ("elements", ctypes.c_int),
        ("scheme", ctypes.c_int),
        ("mass_matrix", ctypes.c_int),
    ]


class _Failure(ctypes.Structure):
    _fields_ = [(name, ctypes.c_double) for name in ("time", "h", "defect", "scale", "allowed")]


def library_path() -> str:
    """Where this host's compiled kernel stands: ``native/<platform>/`` beside the package."""
    folder, suffix = _PLATFORMS.get(sys.platform, ("unknown", "so"))
    root = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    return os.path.join(root, "native", folder, f"chain_kernel.{suffix}")


def load_library(path: str | None = None) -> Any:
    """The compiled kernel, with its functions' types declared. Raises KernelMissing."""
    path = os.path.abspath(path or library_path())
    try:
        library = ctypes.CDLL(path)
        version = library.chain_version()
    except (OSError, AttributeError) as error:
        raise KernelMissing(f"no compiled kernel fits this host: {error}") from None
    if version != KERNEL_VERSION:
        raise KernelMissing(f"{path} is of version {version}; version {KERNEL_VERSION} is needed")
    sizes = library.chain_output_count(), library.chain_settings_size()
    if sizes != (len(OUTPUTS), ctypes.sizeof(_Settings)):
        raise KernelMissing(f"{path} has another interface than this package: {sizes}")
    number, pointer = ctypes.c_double, ctypes.c_void_p
    library.chain_memory.restype = ctypes.c_size_t
    library.chain_memory.argtypes = [ctypes.c_int]
    library.chain_create.restype = pointer
    library.chain_create.argtypes = [pointer, pointer]
    library.chain_step.restype = ctypes.c_int
    library.chain_step.argtypes = [pointer, number, number, number, number, pointer]
    library.chain_outputs.restype = None
    library.chain_outputs.argtypes = [pointer, pointer]
    library.chain_state_count.restype = ctypes.c_size_t
    library.chain_state_count.argtypes = [ctypes.c_int]
    library.chain_state.restype = ctypes.POINTER(number)
    library.chain_state.argtypes = [pointer]
    return library


class NativeCrane:
    """The nonlinear crane of ``nonlinear.NonlinearCrane``, in C."""

    def __init__(
        self,
        crane: Crane | None = None,
        initial: Initial | None = None,
        numerics: Numerics | None = None,
        library: Any = None,
    ) -> None:
        self.crane = crane or Crane()
        self.initial = initial or Initial()
        self.numerics = numerics or Numerics()
        check(self.crane, self.initial, self.numerics)
        c = library or load_library()
        elements = self.numerics.elements
        settings = _Settings(
            self.crane.chain.length,
            self.crane.chain.mass,
            self.crane.chain.EA,
            self.crane.payload.mass,
            self.crane.gravity,
            self.crane.damping.air,
            self.crane.damping.chain,
            self.initial.speed,
            self.initial.sway_angle,
            self.numerics.max_step,
            elements,
            SCHEMES.index(self.numerics.scheme),
            MASS_MATRICES.index(self.numerics.mass_matrix),
        )
        self._memory = (ctypes.c_double * (c.chain_memory(elements) // 8))()
        self._kernel = c.chain_create(self._memory, ctypes.byref(settings))
        self._count = c.chain_state_count(elements)
        self._state = c.chain_state(self._kernel)
        self._failure = _Failure()
        self._failure_address = ctypes.addressof(self._failure)
        self._outputs = (ctypes.c_double * len(OUTPUTS))()
        self.start_time = 0.0  # s, the host's; only for messages
        self._c_step, self._c_outputs = c.chain_step, c.chain_outputs

    def step(
        self, h: float, v_cmd: float = 0.0, a_cmd: float = 0.0, payload_fx: float = 0.0
    ) -> None:
        """Advance by ``h`` seconds under held commands, as :meth:`NonlinearCrane.step` does."""
        try:
            kind = self._c_step(self._kernel, h, v_cmd, a_cmd, payload_fx, self._failure_address)
        except ctypes.ArgumentError:
            kind = _BAD_VALUE
        if kind != _OK:
            self._raise(kind, h, v_cmd, a_cmd, payload_fx)

    def _raise(self, kind: int, h: float, v_cmd: float, a_cmd: float, payload_fx: float) -> None:
        if kind == _BAD_VALUE:
            checked_move(self.trolley, self.numerics.max_step, h, v_cmd, a_cmd, payload_fx)
        failure = self._failure
        h, energy = failure.h, (failure.defect, failure.scale, failure.allowed)
        error: CraneError
        if kind == _STEP_ENERGY:
            error = EnergyBalanceBroken.in_step(h, *energy)
        elif kind == _TOTAL_ENERGY:
            error = EnergyBalanceBroken.since_start(*energy)
        elif kind == _SINGULAR:
            error = NotConverged.singular(h)
        else:
            error = NotConverged.in_step(h)
        when = self.start_time + failure.time
        raise type(error)(f"at t = {when:.6g} s: {error}")

    @property
    def time(self) -> float:
        """Time since the start, s."""
        return float(self._state[0])

    @property
    def trolley(self) -> Trolley:
        """The trolley."""
        return Trolley(*self._state[1:4])

    @property
    def effort(self) -> Effort:
        """Cost of the last communication step."""
        return Effort(int(self._state[4]), int(self._state[5]))

    @property
    def ledger(self) -> Ledger:
        """The energy ledger."""
        return Ledger(*self._state[6:10])

    @property
    def energy(self) -> float:
        """Mechanical energy above the rest position, J."""
        return float(self._state[14])

    @property
    def motion(self) -> tuple[list[float], list[float]]:
        """Positions and velocities of the free nodes relative to the trolley: x, y, x, y, ..."""
        size = 2 * self.numerics.elements
        values = self._state[_HEADER : _HEADER + 2 * size]
        return values[:size], values[size:]

    def output_values(self) -> list[float]:
        """All outputs in the interface's order, in SI units."""
        self._c_outputs(self._kernel, self._outputs)
        *real, steps, iterations = self._outputs
        return [*real, int(steps), int(iterations)]

    def outputs(self) -> dict[str, float]:
        """All outputs by their FMU names, in SI units, in the interface's order."""
        names = (variable.name for variable in OUTPUTS)
        return dict(zip(names, self.output_values(), strict=True))

    def save(self) -> bytes:
        """The whole state, bit for bit, as NonlinearCrane saves it; parameters are not in it."""
        return ctypes.string_at(self._state, 8 * self._count)

    def load(self, state: bytes) -> None:
        """Restore what :meth:`save` gave, in a crane with the same parameters.

        Raises BadState, the crane unchanged, where the size does not fit.
        """
        if len(state) != 8 * self._count:
            raise BadState("the saved state is of a crane with another number of elements")
        ctypes.memmove(self._state, state, len(state))
