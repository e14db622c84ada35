"""The loop over communication steps, of one FMU or of several that are wired to each other.

It is a library in C, ``stepper.c`` beside the kernels, as a loop in Python takes longer than the
cranes do. Where it cannot be compiled, the same loop in Python runs, over FMPy's calls.
"""

from __future__ import annotations

import ctypes
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from fmpy import platform as platform_name
from fmpy import sharedLibraryExtension
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave
from numpy.typing import NDArray

from .shipped import STEPPER

CACHE = "CHAINCRANE_CACHE"  # environment variable: where the compiled stepper is kept
NOT_COMPILED = "CHAINCRANE_NO_STEPPER"  # environment variable: if set, the loop is Python's


@dataclass
class Part:
    """One FMU of a run: an initialised slave, what is set in it, and tables of what is read.

    ``input_table`` has a row of Real inputs for each step; the other tables have a row of outputs
    for each communication point, one more than there are steps.
    """

    slave: FMU2Slave
    inputs: Sequence[int]  # value references
    input_table: NDArray[np.float64]
    reals: Sequence[int]
    integers: Sequence[int] = ()
    booleans: Sequence[int] = ()
    real_table: NDArray[np.float64] = field(init=False)
    integer_table: NDArray[np.int32] = field(init=False)
    boolean_table: NDArray[np.int32] = field(init=False)

    def __post_init__(self) -> None:
        rows = len(self.input_table) + 1
        self.real_table = np.full((rows, len(self.reals)), np.nan)
        self.integer_table = np.zeros((rows, len(self.integers)), np.int32)
        self.boolean_table = np.zeros((rows, len(self.booleans)), np.int32)


@dataclass(frozen=True)
class Wire:
    """A Real output that is another part's input: places of parts, columns of their tables."""

    source: int
    output: int
    sink: int
    input: int


class Stopped(Exception):
    """A step could not be done: the part and the number of the step."""

    def __init__(self, part: int, step: int, error: FMICallException) -> None:
        super().__init__(str(error))
        self.part, self.step, self.error = part, step, error


class Stepper:
    """Steps the parts of one run over a grid of communication points.

    Step i goes from ``times[i]`` over ``sizes[i]``, in s. ``sequential``: a part sees what those
    before it gave in the same step; else what all gave at its start.
    """

    def __init__(
        self,
        parts: Sequence[Part],
        times: NDArray[np.float64],
        sizes: NDArray[np.float64],
        wires: Sequence[Wire] = (),
        sequential: bool = False,
    ) -> None:
        self.parts, self.wires, self.sequential = parts, wires, sequential
        self.times, self.sizes = times, sizes
        self._set: list[NDArray[np.float64] | None] = [None] * len(parts)
        self._library = library()
        if self._library is not None:
            structures = [_structure(part) for part in parts]
            self._kept = [arrays for _, arrays in structures]
            self._parts = (_Part * len(parts))(*(one for one, _ in structures))
            self._wires = (_Wire * len(wires))(
                *(_Wire(one.source, one.output, one.sink, one.input) for one in wires)
            )

    def look(self, row: int) -> None:
        """Read all parts' outputs into a row. Raises Stopped."""
        for place, part in enumerate(self.parts):
            self._look(place, part, row)

    def advance(self, first: int, last: int) -> None:
        """Do the steps ``first`` to ``last`` - 1; row i of the outputs is known. Raises Stopped."""
        if self._library is None:
            for step in range(first, last):
                self._step(step)
            return
        stop = _Stop()
        done = self._library.stepper_run(
            self._parts,
            len(self.parts),
            self._wires,
            len(self.wires),
            self.sequential,
            self.times.ctypes.data,
            self.sizes.ctypes.data,
            first,
            last,
            ctypes.byref(stop),
        )
        if done < last - first:
            error = FMICallException(function="fmi2DoStep", status=stop.status)
            raise Stopped(stop.part, first + done, error)

    # --- the loop in Python -------------------------------------------------------------------

    def _step(self, step: int) -> None:
        for place, part in enumerate(self.parts):
            for wire in self.wires:
                if wire.sink == place:
                    row = step + (self.sequential and wire.source < place)
                    taken = self.parts[wire.source].real_table[row, wire.output]
                    part.input_table[step, wire.input] = taken
            values, before = part.input_table[step], self._set[place]
            try:
                if len(values) and (before is None or values.tobytes() != before.tobytes()):
                    part.slave.setReal(part.inputs, values)
                    self._set[place] = values
                part.slave.doStep(float(self.times[step]), float(self.sizes[step]))
            except FMICallException as error:
                raise Stopped(place, step, error) from error
            self._look(place, part, step + 1)

    def _look(self, place: int, part: Part, row: int) -> None:
        slave = part.slave
        try:
            if part.reals:
                part.real_table[row] = slave.getReal(part.reals)
            if part.integers:
                part.integer_table[row] = slave.getInteger(part.integers)
            if part.booleans:
                part.boolean_table[row] = slave.getBoolean(part.booleans)
        except FMICallException as error:
            raise Stopped(place, row - 1, error) from error


# --- the loop in C ------------------------------------------------------------------------------

_FUNCTIONS = ("SetReal", "GetReal", "GetInteger", "GetBoolean", "DoStep")
_COUNTS = ("input_count", "real_count", "integer_count", "boolean_count")
_ARRAYS = ("inputs", "reals", "integers", "booleans")
_TABLES = ("input_table", "real_table", "integer_table", "boolean_table")


class _Part(ctypes.Structure):
    _fields_ = (
        ("component", ctypes.c_void_p),
        *((name, ctypes.c_void_p) for name in _FUNCTIONS),
        *((name, ctypes.c_size_t) for name in _COUNTS),
        *((name, ctypes.c_void_p) for name in (*_ARRAYS, *_TABLES)),
    )


class _Wire(ctypes.Structure):
    _fields_ = tuple((name, ctypes.c_size_t) for name in ("source", "output", "sink", "input"))


class _Stop(ctypes.Structure):
    _fields_ = (("part", ctypes.c_size_t), ("status", ctypes.c_int))


def _structure(part: Part) -> tuple[_Part, list[Any]]:
    """A part as C takes it, and what it points to beside the part's own tables."""
    made = _Part(part.slave.component)
    for name in _FUNCTIONS:
        function = getattr(part.slave.dll, f"fmi2{name}")
        setattr(made, name, ctypes.cast(function, ctypes.c_void_p).value)
    kept = []
    for count, name, table in zip(_COUNTS, _ARRAYS, _TABLES, strict=True):
        references = np.array(getattr(part, name), np.uint32)
        kept.append(references)
        setattr(made, count, len(references))
        setattr(made, name, references.ctypes.data)
        setattr(made, table, getattr(part, table).ctypes.data)
    return made, kept


@cache
def library() -> Any:
    """The stepper in C: a wheel's, or compiled where this machine has not got it; None: neither."""
    if os.environ.get(NOT_COMPILED):
        return None
    for path in (_shipped, _compiled):
        try:
            found = ctypes.CDLL(str(path()))
            sizes = [found.stepper_layout(place) for place in range(3)]
        except (OSError, AttributeError, ImportError, subprocess.CalledProcessError):
            continue
        if sizes == [ctypes.sizeof(one) for one in (_Part, _Wire, _Stop)]:
            pointer, count = ctypes.c_void_p, ctypes.c_size_t
            found.stepper_run.restype = count
            found.stepper_run.argtypes = [pointer, count, pointer, count, ctypes.c_int]
            found.stepper_run.argtypes += [pointer, pointer, count, count, pointer]
            return found
    return None


def _shipped() -> Path:
    """The library that came with this package. Raises OSError."""
    return STEPPER / str(platform_name) / f"stepper{sharedLibraryExtension}"


def _compiled() -> Path:
    """The compiled stepper of this source, made if it is not there yet.

    Raises OSError, ImportError, CalledProcessError where it cannot be made.
    """
    import chaincrane_builder

    builder = Path(chaincrane_builder.__file__).parent
    compiler = builder / "compile_c.py"
    source = builder.parent / "native" / "stepper.c"
    made_from = sha256(source.read_bytes() + compiler.read_bytes()).hexdigest()[:16]
    place = cache_folder() / f"stepper-{sys.platform}-{platform.machine()}-{made_from}"
    if not place.exists():
        from chaincrane_builder.stepper import for_host

        place.parent.mkdir(parents=True, exist_ok=True)  # else it would be compiled each time
        made = for_host()
        with tempfile.TemporaryDirectory(dir=place.parent) as folder:
            file = Path(folder, place.name)
            file.write_bytes(made)
            file.replace(place)  # whole, whoever else makes it
    return place


def cache_folder() -> Path:
    """Where compiled libraries are kept from run to run."""
    if os.environ.get(CACHE):
        return Path(os.environ[CACHE])
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or tempfile.gettempdir()
    else:
        base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(base, "chaincrane")
