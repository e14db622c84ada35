"""The anti-sway loop: crane, observer and controller as FMUs, stepped by a plain FMPy master.

Two orders of stepping. `parallel`, as libcosim and ecos do: all parts step with what the others
gave at the step's start. `sequential`: crane, observer, controller, each with what is newest.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from ctypes import byref
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from fmpy import extract
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    FMU2Slave,
    calloc,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
    free,
)
from fmpy.logging import addLoggerProxy

from .errors import UserError
from .progress import REPORTS, Progress
from .simulate import describe
from .start_values import check_start_values
from .tables import Table

CRANE, OBSERVER, ANTISWAY = "crane", "observer", "antisway"
ORDERS = ("parallel", "sequential")
SEPARATOR = "::"  # between part and variable, in a column's name

Connection = tuple[str, str, str, str]  # from part, its output, to part, its input
CONNECTIONS: tuple[Connection, ...] = (
    (ANTISWAY, "trolley.a_cmd", CRANE, "trolley.a_cmd"),
    (ANTISWAY, "trolley.a_cmd", OBSERVER, "trolley.a_cmd"),
    (CRANE, "payload.x_rel", OBSERVER, "camera.x_rel"),
    (CRANE, "chain.top_angle", OBSERVER, "rope.top_angle"),
    (CRANE, "trolley.x", ANTISWAY, "trolley.x"),
    (CRANE, "trolley.v", ANTISWAY, "trolley.v"),
    (OBSERVER, "mode.x_rel[1]", ANTISWAY, "mode.x_rel[1]"),
    (OBSERVER, "mode.x_rel[2]", ANTISWAY, "mode.x_rel[2]"),
    (OBSERVER, "mode.vx_rel[1]", ANTISWAY, "mode.vx_rel[1]"),
    (OBSERVER, "mode.vx_rel[2]", ANTISWAY, "mode.vx_rel[2]"),
)
WATCHED = {
    CRANE: (
        "trolley.x",
        "trolley.v",
        "payload.x",
        "payload.x_rel",
        "chain.mid_x_rel",
        "chain.top_angle",
    ),
    OBSERVER: (
        "payload.x_rel",
        "payload.vx_rel",
        "chain.mid_x_rel",
        "chain.top_angle",
        "std.payload.x_rel",
    ),
    ANTISWAY: ("trolley.a_cmd",),
}


def column(part: str, variable: str) -> str:
    """The name of a result's column."""
    return f"{part}{SEPARATOR}{variable}"


@dataclass(frozen=True)
class Loop:
    """A run of connected FMUs from 0 to ``stop_time`` s in steps of ``step`` s.

    ``fmus`` and ``start`` go by part; a connection of a part that is not there is left out.
    ``inputs``: what the loop does not drive; its columns are named like a result's, and a value
    holds from its row's time on.
    """

    fmus: Mapping[str, Path]
    start: Mapping[str, Mapping[str, Any]]
    stop_time: float
    step: float
    order: str = "parallel"
    inputs: Table | None = None
    watched: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: WATCHED)

    @property
    def name(self) -> str:
        """What messages call it."""
        return " + ".join(path.name for path in self.fmus.values())

    @property
    def steps(self) -> int:
        """Number of communication steps."""
        return round(self.stop_time / self.step)

    @property
    def connections(self) -> list[Connection]:
        """Those whose ends are both there."""
        return [one for one in CONNECTIONS if one[0] in self.fmus and one[2] in self.fmus]

    @property
    def columns(self) -> list[tuple[str, str]]:
        """Part and variable of each column of the result."""
        return [(part, name) for part in self.fmus for name in self.watched[part]]

    def table(self) -> Table:
        """An empty result."""
        names = ["time", *(column(*one) for one in self.columns)]
        return np.zeros(self.steps + 1, dtype=[(name, float) for name in names])

    def run(self, progress: Progress) -> Table:
        """Step the FMUs in this process, telling ``progress`` the time. Raises UserError."""
        with ExitStack() as stack:
            log = Log()
            parts = {
                name: stack.enter_context(Part(name, fmu, self.start.get(name, {}), log))
                for name, fmu in self.fmus.items()
            }
            return self._run(parts, progress)

    def _run(self, parts: dict[str, Part], progress: Progress) -> Table:
        wires = [
            (parts[source], output, parts[sink], taken)
            for source, output, sink, taken in self.connections
        ]
        for name, part in parts.items():
            read = [output for source, output, _, _ in self.connections if source == name]
            part.begin(dict.fromkeys([*read, *self.watched[name]]))
        for source, output, sink, taken in wires:
            sink.set(taken, source.seen[output])
        for part in parts.values():
            part.end_initialisation()
        result, changes = self.table(), self._changes()
        every = max(1, self.steps // REPORTS)
        for number in range(self.steps + 1):
            time = number * self.step
            values = [parts[name].seen[variable] for name, variable in self.columns]
            result[number] = (time, *values)
            if number == self.steps:
                break
            for name, variable, value in changes.get(number, ()):
                parts[name].set(variable, value)
            if self.order == "parallel":
                for source, output, sink, taken in wires:
                    sink.set(taken, source.seen[output])
            for part in parts.values():
                if self.order == "sequential":
                    for source, output, sink, taken in wires:
                        if sink is part:
                            sink.set(taken, source.seen[output])
                part.step(time, self.step)
            if number % every == 0:
                progress(time)
        return result

    def _changes(self) -> dict[int, list[tuple[str, str, float]]]:
        """Inputs that the loop does not drive, by the number of the step that they come before."""
        found: dict[int, list[tuple[str, str, float]]] = {}
        if self.inputs is None:
            return found
        assert self.inputs.dtype.names is not None
        _, *names = self.inputs.dtype.names
        for row in self.inputs:
            number = round(float(row["time"]) / self.step)
            for name in names:
                part, variable = name.split(SEPARATOR)
                found.setdefault(number, []).append((part, variable, float(row[name])))
        return found


class Log:
    """What the FMUs of a process say. One for all: FMPy's proxy knows the last logger alone."""

    def __init__(self) -> None:
        self.first: tuple[str, str] | None = None  # instance and what it said
        self.callbacks = fmi2CallbackFunctions()
        self.callbacks.logger = fmi2CallbackLoggerTYPE(self._keep)
        self.callbacks.allocateMemory = fmi2CallbackAllocateMemoryTYPE(calloc)
        self.callbacks.freeMemory = fmi2CallbackFreeMemoryTYPE(free)
        addLoggerProxy(byref(self.callbacks))

    def _keep(self, _env: Any, name: bytes, _status: int, _kind: bytes, message: bytes) -> None:
        if self.first is None:
            self.first = name.decode(errors="replace"), message.decode(errors="replace")


class Part:
    """One FMU of a loop: its variables by name, its errors as UserError."""

    def __init__(self, name: str, fmu: Path, start: Mapping[str, Any], log: Log) -> None:
        self.name, self.fmu, self.start, self._log = name, fmu, start, log
        self.seen: dict[str, float] = {}  # outputs, when they were last read
        self._description = describe(fmu)
        self._variables = {v.name: v for v in self._description.modelVariables}
        check_start_values(fmu, self._description, start)

    def __enter__(self) -> Part:
        self._folder = extract(str(self.fmu))
        self._slave = FMU2Slave(
            guid=self._description.guid,
            unzipDirectory=self._folder,
            modelIdentifier=self._description.coSimulation.modelIdentifier,
            instanceName=self.name,
        )
        self._slave.instantiate(callbacks=self._log.callbacks, loggingOn=True)
        return self

    def __exit__(self, *_: object) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)

    def begin(self, outputs: Iterable[str]) -> None:
        """Set the start values; initialisation begins. ``outputs``: what is read from here on."""
        self._outputs = list(outputs)
        self._references = [self._variables[name].valueReference for name in self._outputs]
        self._slave.setupExperiment(startTime=0.0)
        for name, value in self.start.items():
            self.set(name, value)
        self._slave.enterInitializationMode()
        self._look()

    def end_initialisation(self) -> None:
        """From here on the part can step."""
        self._slave.exitInitializationMode()
        self._look()

    def set(self, name: str, value: Any) -> None:
        """Set one variable."""
        variable = self._variables[name]
        if variable.type == "Real":
            value = float(value)
        getattr(self._slave, f"set{variable.type}")([variable.valueReference], [value])

    def _look(self) -> None:
        """Read the outputs, all in one call."""
        self.seen = dict(zip(self._outputs, self._slave.getReal(self._references), strict=True))

    def step(self, time: float, h: float) -> None:
        """One communication step. Raises UserError with what the FMU says."""
        try:
            self._slave.doStep(currentCommunicationPoint=time, communicationStepSize=h)
        except FMICallException as error:
            part, reason = self._log.first or (self.name, str(error))
            raise UserError(f"{part}: stopped before {time + h:g} s: {reason}") from error
        self._look()
