"""The anti-sway loop: crane, observer and controller as FMUs, stepped by a plain FMPy master.

Two orders of stepping. `parallel`, as libcosim and ecos do: all parts step with what the others
gave at the step's start. `sequential`: crane, observer, controller, each with what is newest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from fmpy.fmi1 import FMICallException
from numpy.typing import NDArray

from .errors import UserError
from .instances import Instance, Instances
from .progress import REPORTS, Progress
from .stepper import Part, Stepper, Stopped, Wire
from .tables import Table, column_names

Values = NDArray[np.float64]

CRANE, OBSERVER, ANTISWAY = "crane", "observer", "antisway"
ORDERS = ("parallel", "sequential")
SEPARATOR = "::"  # between part and variable, in a column's name

MODE_SHARES = tuple(f"mode.{name}[{i}]" for name in ("x_rel", "vx_rel") for i in range(1, 5))
Connection = tuple[str, str, str, str]  # from part, its output, to part, its input
CONNECTIONS: tuple[Connection, ...] = (
    (ANTISWAY, "trolley.a_cmd", CRANE, "trolley.a_cmd"),
    (ANTISWAY, "trolley.a_cmd", OBSERVER, "trolley.a_cmd"),
    (CRANE, "payload.x_rel", OBSERVER, "camera.x_rel"),
    (CRANE, "chain.top_angle", OBSERVER, "rope.top_angle"),
    (CRANE, "trolley.x", ANTISWAY, "trolley.x"),
    (CRANE, "trolley.v", ANTISWAY, "trolley.v"),
    *((OBSERVER, name, ANTISWAY, name) for name in MODE_SHARES),
    (OBSERVER, "wind.fx", ANTISWAY, "wind.fx"),
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

    def run(self, instances: Instances, progress: Progress | None = None) -> Table:
        """Step the FMUs in this process, telling ``progress`` the time. Raises UserError."""
        parts = {name: instances.get(fmu, name) for name, fmu in self.fmus.items()}
        instances.log.said.clear()
        return _Run(self, parts, instances).result(progress)


@dataclass(frozen=True)
class Series:
    """Loops that one worker runs in a row: what they have alike, a plan say, its FMUs make once."""

    loops: Sequence[Loop]

    @property
    def name(self) -> str:
        """What messages call it."""
        return self.loops[0].name

    @property
    def stop_time(self) -> float:
        """Simulated time of all, s."""
        return sum(loop.stop_time for loop in self.loops)

    def run(self, instances: Instances, progress: Progress | None = None) -> list[Table]:
        """Each loop's result. Raises UserError."""
        results, done = [], 0.0
        for loop in self.loops:
            results.append(loop.run(instances, _later(progress, done)))
            done += loop.stop_time
        return results


def _later(progress: Progress | None, start: float) -> Progress | None:
    """What is told a time ``start`` s later."""
    return None if progress is None else lambda time: progress(start + time)


class _Run:
    """A loop's run in loaded FMUs."""

    def __init__(self, loop: Loop, instances: Mapping[str, Instance], loaded: Instances) -> None:
        self._loop, self._instances, self._loaded = loop, instances, loaded
        self._names = list(instances)
        times = np.array([number * loop.step for number in range(loop.steps + 1)])
        self._inputs = {name: self._told(name) for name in instances}
        self._outputs = {name: self._read(name) for name in instances}
        self._parts = [
            Part(
                instance.slave,
                instance.references(self._inputs[name], "Real"),
                self._input_table(name),
                instance.references(self._outputs[name], "Real"),
            )
            for name, instance in instances.items()
        ]
        self._wires = [
            Wire(
                self._names.index(source),
                self._outputs[source].index(output),
                self._names.index(sink),
                self._inputs[sink].index(taken),
            )
            for source, output, sink, taken in loop.connections
        ]
        sizes = np.full(loop.steps, loop.step)
        self._stepper = Stepper(self._parts, times, sizes, self._wires, loop.order == "sequential")

    def _told(self, part: str) -> list[str]:
        """Inputs of a part that the loop sets: those of connections, and of its own inputs."""
        wired = [taken for _, _, sink, taken in self._loop.connections if sink == part]
        given = [variable for owner, variable in self._given() if owner == part]
        return list(dict.fromkeys([*wired, *given]))

    def _read(self, part: str) -> list[str]:
        """Outputs of a part that are connected or watched."""
        wired = [output for source, output, _, _ in self._loop.connections if source == part]
        return list(dict.fromkeys([*wired, *self._loop.watched[part]]))

    def _given(self) -> list[tuple[str, str]]:
        """Part and variable of each column of the loop's own inputs."""
        if self._loop.inputs is None:
            return []
        found = []
        for name in column_names(self._loop.inputs)[1:]:
            part, _, variable = name.partition(SEPARATOR)
            found.append((part, variable))
        return found

    def _input_table(self, part: str) -> Values:
        """A row of inputs for each step: from its row's time on, a value that is given holds."""
        names, instance, loop = self._inputs[part], self._instances[part], self._loop
        start = loop.start.get(part, {})
        values = [start.get(name, instance.variables[name].start or 0.0) for name in names]
        table = np.tile(np.array(values, float), (loop.steps, 1))
        if loop.inputs is not None:
            for row in loop.inputs:
                step = round(float(row["time"]) / loop.step)
                for owner, variable in self._given():
                    if owner == part:
                        given = row[column(owner, variable)]
                        table[step:, names.index(variable)] = given
        return table

    def result(self, progress: Progress | None) -> Table:
        """Run from 0 s to the end. Raises UserError."""
        loop, bunch = self._loop, self._loop.steps
        if progress is not None:
            bunch = max(1, loop.steps // REPORTS)
        try:
            self._begin()
            for first in range(0, loop.steps, bunch):
                last = min(first + bunch, loop.steps)
                self._stepper.advance(first, last)
                if progress is not None:
                    progress(last * loop.step)
        except Stopped as stop:
            instance = self._instances[self._names[stop.part]]
            name, reason = self._loaded.failed(instance, stop.error)
            when = (stop.step + 1) * loop.step
            raise UserError(f"{name}: stopped before {when:g} s: {reason}") from stop
        result = loop.table()
        result["time"] = self._stepper.times
        for name, variable in loop.columns:
            place = self._outputs[name].index(variable)
            table = self._parts[self._names.index(name)].real_table
            result[column(name, variable)] = table[:, place]
        return result

    def _begin(self) -> None:
        """Initialise: what is connected is handed over once before initialisation ends."""
        for name in self._names:
            self._try(name, "begin", self._loop.start.get(name, {}), self._loop.stop_time)
        self._stepper.look(0)
        for wire in self._wires:
            sink = self._parts[wire.sink]
            taken = self._parts[wire.source].real_table[0, wire.output]
            sink.slave.setReal([sink.inputs[wire.input]], [taken])
        for name in self._names:
            self._try(name, "end_initialisation")
        self._stepper.look(0)

    def _try(self, name: str, call: str, *arguments: Any) -> None:
        """Call a part's instance. Raises UserError with what the FMU says."""
        instance = self._instances[name]
        try:
            getattr(instance, call)(*arguments)
        except FMICallException as error:
            name, reason = self._loaded.failed(instance, error)
            raise UserError(f"{name}: not initialised: {reason}") from error
