"""A crane stepped by its twin in C: what NonlinearCrane or LinearCrane does, at the speed of C.

The NumPy models are the definition; ``native/`` has the same equations under the same names. The
structures that go between the two are made from the interface's table, here and in C. Nothing here
needs NumPy, so that a start is light.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterable, Sequence
from dataclasses import fields
from enum import IntEnum
from hashlib import sha256
from typing import Any

from ..errors import BadState, CraneError, EnergyBalanceBroken, NotConverged
from ..variables import values_of
from ..whole_step import FINITE_STEP, check_finite
from .command import IDLE, Command
from .interface import (
    INPUTS,
    LINEAR_STATE,
    NONLINEAR_STATE,
    OUTPUTS,
    PARAMETERS,
    PAST_STEP,
    SHARED_STATE,
    TOLERANCE_STATE,
)
from .ledger import Effort, Ledger
from .parameters import Crane, Initial, Numerics, check
from .trolley import Trolley, checked_move

KERNEL = "crane_kernel"  # the library's name
PLATFORMS = {  # of this process -> FMI's name of it, a library's suffix
    "linux": ("linux64", "so"),
    "win32": ("win64", "dll"),
    "darwin": ("darwin64", "dylib"),
}
FAILURE = {  # why a step failed
    "time": "s, where the step that failed began",
    "h": "s, its length",
    "defect": "J, what the energy balance is off by",
    "scale": "J, what that is measured against",
    "allowed": "of the scale",
}


class Outcome(IntEnum):
    """How a step in C ends."""

    DONE = 0
    NOT_CONVERGED = 1  # the iteration for dynamic equilibrium did not converge
    SINGULAR = 2  # newmark: the effective stiffness is singular
    STEP_ENERGY = 3  # a step is off its energy balance
    TOTAL_ENERGY = 4  # the balance since the start is off
    BAD_VALUE = 5  # a command or the step size is not allowed
    NOT_FINITE = 6  # an output is not a finite number


class KernelMissing(CraneError):
    """No compiled kernel fits this host."""


def _structure(name: str, members: Iterable[str]) -> type[ctypes.Structure]:
    """A structure of doubles."""
    rows = [(member, ctypes.c_double) for member in members]
    return type(name, (ctypes.Structure,), {"_fields_": rows})


_Settings = _structure("Settings", (row.symbol for row in PARAMETERS))
_Command = _structure("Command", (row.symbol for row in INPUTS))
_Failure = _structure("Failure", FAILURE)
_COMMAND_FIELDS = tuple(field.name for field in fields(Command))
_OUTPUT_NAMES = tuple(row.name for row in OUTPUTS)


class _Exchange(ctypes.Structure):
    """What the two hand each other at a step; kernel.c says what each is."""

    _fields_ = (
        ("memory", ctypes.c_void_p),
        ("kept", ctypes.c_void_p),
        ("command", _Command),
        ("outputs", ctypes.c_double * len(OUTPUTS)),
        ("notice", ctypes.c_char_p),
        ("failure", _Failure),
    )


def layout() -> str:
    """A hash of all that this package and a compiled kernel hand each other."""
    parameters = [(row.name, row.kind, row.choices) for row in PARAMETERS]
    names = [[row.name for row in INPUTS], parameters, [row.name for row in OUTPUTS]]
    states = [list(one) for one in (NONLINEAR_STATE, TOLERANCE_STATE, PAST_STEP, LINEAR_STATE)]
    shared = repr((names, states, list(FAILURE), [(kind.name, kind.value) for kind in Outcome]))
    return sha256(shared.encode()).hexdigest()


def library_path() -> str:
    """Where this host's compiled kernel stands: ``native/<platform>/`` beside the package."""
    folder, suffix = PLATFORMS.get(sys.platform, ("unknown", "so"))
    package = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    return os.path.join(os.path.dirname(package), "native", folder, f"{KERNEL}.{suffix}")


def load_library(path: str | None = None) -> Any:
    """The compiled kernel, with its functions' types declared. Raises KernelMissing."""
    path = os.path.abspath(path or library_path())
    number, pointer = ctypes.c_double, ctypes.c_void_p
    try:
        library = ctypes.CDLL(path)
        library.crane_layout.restype = ctypes.c_char_p
        found = library.crane_layout().decode()
    except (OSError, AttributeError) as error:
        raise KernelMissing(f"no compiled kernel fits this host: {error}") from None
    if found != layout():
        raise KernelMissing(f"{path} has another interface than this package: compile it anew")
    library.crane_memory.restype = ctypes.c_size_t
    library.crane_memory.argtypes = [pointer]
    library.crane_create.restype = None
    library.crane_create.argtypes = [pointer, pointer]
    library.crane_keep.restype = ctypes.c_size_t
    library.crane_keep.argtypes = [pointer, pointer]
    library.crane_look.restype = None
    library.crane_look.argtypes = [pointer]
    library.crane_step.restype = ctypes.c_int
    library.crane_step.argtypes = [pointer, number]
    library.crane_shared.restype = ctypes.POINTER(number)
    library.crane_shared.argtypes = [pointer]
    library.crane_save.restype = ctypes.c_size_t
    library.crane_save.argtypes = [pointer, pointer]
    library.crane_load.restype = ctypes.c_int
    library.crane_load.argtypes = [pointer, pointer, ctypes.c_size_t]
    return library


class NativeCrane:
    """A crane in C: the nonlinear one, or the one whose library is given."""

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
        settings = ctypes.byref(self._settings())
        self._memory = (ctypes.c_double * (c.crane_memory(settings) // 8))()
        self._address = ctypes.addressof(self._memory)
        c.crane_create(self._address, settings)
        self._shared_state = c.crane_shared(self._address)
        self._kept = (ctypes.c_double * c.crane_keep(self._address, None))()
        self._exchange: Any = _Exchange(self._address, ctypes.addressof(self._kept))
        self._exchange_address = ctypes.addressof(self._exchange)
        self._command = self._exchange.command
        self._held: Command | None = None  # what self._command was filled from
        # A view of the outputs: to make a list of a ctypes array takes ten times as long.
        self._seen: Any = memoryview(self._exchange.outputs).cast("B").cast("d")
        self.start_time = 0.0  # s, the host's; only for messages
        self._c_step, self._c_look = c.crane_step, c.crane_look
        self._c_save, self._c_load = c.crane_save, c.crane_load
        self._c_look(self._exchange_address)

    def _settings(self) -> ctypes.Structure:
        """The parameters as C takes them, by name; of a String the place of its choice."""
        values = values_of(self.crane) | values_of(self.initial) | values_of(self.numerics)
        chosen = {
            row.symbol: row.choices.index(values[row.name]) if row.choices else values[row.name]
            for row in PARAMETERS
        }
        return _Settings(**chosen)

    def step(self, h: float, command: Command = IDLE) -> None:
        """Advance by ``h`` seconds under a held command, as :meth:`CraneModel.step` does."""
        self.advance(h, command)

    def advance(self, h: float, command: Command = IDLE) -> Sequence[float]:
        """As :meth:`step`; a view of the outputs, all finite: it shows what is now."""
        try:
            if command is not self._held:
                for name in _COMMAND_FIELDS:
                    setattr(self._command, name, getattr(command, name))
                self._held = command
            outcome = self._c_step(self._exchange_address, h)
        except (ctypes.ArgumentError, TypeError):
            self._held = None
            outcome = Outcome.BAD_VALUE
        if outcome:
            self._raise(outcome, h, command)
        seen: Sequence[float] = self._seen
        return seen

    def _raise(self, outcome: int, h: float, command: Command) -> None:
        if outcome == Outcome.BAD_VALUE:
            checked_move(self.trolley, self.numerics.max_step, h, command)
        if outcome == Outcome.NOT_FINITE:
            refused = self.outputs()
            self._c_look(self._exchange_address)
            check_finite(refused, FINITE_STEP)
        failure = self._exchange.failure
        h, energy = failure.h, (failure.defect, failure.scale, failure.allowed)
        error: CraneError
        if outcome == Outcome.STEP_ENERGY:
            error = EnergyBalanceBroken.in_step(h, *energy)
        elif outcome == Outcome.TOTAL_ENERGY:
            error = EnergyBalanceBroken.since_start(*energy)
        elif outcome == Outcome.SINGULAR:
            error = NotConverged.singular(h)
        else:
            error = NotConverged.in_step(h)
        when = self.start_time + failure.time
        raise type(error)(f"at t = {when:.6g} s: {error}")

    def _shared(self) -> dict[str, float]:
        """The numbers that every crane's state begins with, by name."""
        return dict(zip(SHARED_STATE, self._shared_state[: len(SHARED_STATE)], strict=True))

    @property
    def time(self) -> float:
        """Time since the start, s."""
        return self._shared()["time"]

    @property
    def trolley(self) -> Trolley:
        """The trolley."""
        return Trolley(**self._group("trolley", Trolley))

    @property
    def effort(self) -> Effort:
        """Cost of the last communication step."""
        shared = self._shared()
        return Effort(int(shared["steps"]), int(shared["iterations"]))

    @property
    def ledger(self) -> Ledger:
        """The energy ledger."""
        return Ledger(**self._group("ledger", Ledger))

    def _group(self, prefix: str, kind: Any) -> dict[str, float]:
        """The numbers of the state that make a ``kind``, by its fields' names."""
        shared = self._shared()
        return {field.name: shared[f"{prefix}_{field.name}"] for field in fields(kind)}

    def notice(self) -> str | None:
        """What a user should be told of the motion, once; None: nothing."""
        text: bytes | None = self._exchange.notice
        return None if text is None else text.decode()

    def output_values(self) -> list[float]:
        """All outputs in the interface's order, in SI units."""
        values: list[float] = self._seen.tolist()
        return values

    def outputs(self) -> dict[str, float]:
        """All outputs by their FMU names, in SI units, in the interface's order."""
        return dict(zip(_OUTPUT_NAMES, self.output_values(), strict=True))

    def save(self) -> bytes:
        """The whole state, bit for bit, as the NumPy model saves it; parameters are not in it."""
        state = (ctypes.c_double * self._c_save(self._address, None))()
        self._c_save(self._address, state)
        return bytes(state)

    def load(self, state: bytes) -> None:
        """Restore what :meth:`save` gave, in a crane with the same parameters.

        Raises BadState, the crane unchanged, where the size does not fit.
        """
        count = len(state) // 8
        numbers = (ctypes.c_double * count).from_buffer_copy(state)
        if len(state) % 8 or not self._c_load(self._address, numbers, count):
            raise BadState.of_other_settings()
        self._c_look(self._exchange_address)
