"""One FMU is run, and its outputs are given back by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelDescription
from numpy.typing import NDArray

from .errors import UserError, instead
from .grid import Grid, all_inputs, grid
from .instances import Instance, Instances
from .progress import REPORTS, Progress
from .stepper import Part, Stepper, Stopped
from .tables import Table, column_names

RECORDED = ("Real", "Integer", "Boolean")  # kinds of outputs, in the order of a result's columns
SAME_AS = {"Enumeration": "Integer"}  # in FMI 2.0


@dataclass(frozen=True)
class Job:
    """One simulation from 0 to ``stop_time`` s, with a result row per ``output_interval`` s.

    ``inputs`` follows FMPy's convention: linear between rows, a repeated time row is a jump. Its
    unknown columns, like unknown ``start_values``, are errors. ``outputs``: what the result has
    beside the time; None: all outputs.
    """

    fmu: Path
    start_values: Mapping[str, Any]
    inputs: Table | None
    stop_time: float
    output_interval: float
    outputs: Sequence[str] | None = None

    @property
    def name(self) -> str:
        """What messages call it."""
        return str(self.fmu)

    def run(self, instances: Instances, progress: Progress | None = None) -> Table:
        """Simulate in this process; ``progress`` is told the time reached. Raises UserError."""
        return simulate(self, instances, progress)


def simulate(job: Job, instances: Instances, progress: Progress | None = None) -> Table:
    """Run a job in one of ``instances``; ``progress`` is told the time reached. Raises UserError.

    The result is what FMPy's simulate_fmu gives, bit for bit: columns by kind, then in the FMU's
    order; a row for each communication point.
    """
    instance = instances.get(job.fmu)
    instances.log.said.clear()
    points = grid_of(job, instance.description)
    names = {kind: _recorded(job, instance, kind) for kind in RECORDED}
    part = Part(
        instance.slave,
        instance.references(_inputs(instance.description), "Real"),
        points.inputs,
        *([instance.variables[name].valueReference for name in names[kind]] for kind in RECORDED),
    )
    stepper = Stepper([part], points.times, points.sizes)
    try:
        instance.begin(job.start_values, job.stop_time)
        if part.inputs:
            instance.slave.setReal(part.inputs, points.initial)
        instance.end_initialisation()
        stepper.look(0)
    except (FMICallException, Stopped) as error:
        _, reason = instances.failed(instance, _cause(error))
        raise UserError(f"{job.fmu}: {reason}") from error
    steps = len(points.sizes)
    bunch = steps if progress is None else max(1, steps // REPORTS)
    for first in range(0, steps, bunch):
        last = min(first + bunch, steps)
        try:
            stepper.advance(first, last)
        except Stopped as stop:
            _, reason = instances.failed(instance, stop.error)
            reached = f"stopped at {points.times[stop.step]:g} s of {job.stop_time:g} s"
            raise UserError(f"{job.fmu}: {reached}: {reason}") from stop
        if progress is not None:
            progress(float(points.times[last]))
    return _table(points, part, names)


def _cause(error: FMICallException | Stopped) -> FMICallException:
    return error.error if isinstance(error, Stopped) else error


def _inputs(description: ModelDescription) -> list[str]:
    """Names of the FMU's Real inputs, in its order."""
    variables = description.modelVariables
    return [v.name for v in variables if v.causality == "input" and v.type == "Real"]


def grid_of(job: Job, description: ModelDescription) -> Grid:
    """A job's communication points, and its inputs at each. Raises UserError."""
    names = _inputs(description)
    for name in () if job.inputs is None else column_names(job.inputs)[1:]:
        if name not in names:
            raise UserError(f"{job.fmu}: {name!r} is not an input{instead(name, names)}")
    start = {v.name: v.start or 0.0 for v in description.modelVariables if v.name in names}
    start |= {name: value for name, value in job.start_values.items() if name in names}
    table = all_inputs(names, job.inputs, {name: float(value) for name, value in start.items()})
    return grid(description, table, job.stop_time, job.output_interval)


def _recorded(job: Job, instance: Instance, kind: str) -> list[str]:
    """Names of the variables of a kind that the result has, in the FMU's order."""
    for name in job.outputs or ():
        if name not in instance.variables:
            raise UserError(f"{job.fmu}: there is no variable {name!r}")
    return [
        name
        for name, variable in instance.variables.items()
        if SAME_AS.get(variable.type, variable.type) == kind
        and (variable.causality == "output" if job.outputs is None else name in job.outputs)
    ]


def _table(points: Grid, part: Part, names: Mapping[str, Sequence[str]]) -> Table:
    """The outputs as one table."""
    kinds = {"Real": np.float64, "Integer": np.int32, "Boolean": np.bool_}
    columns: list[tuple[str, Any]] = [("time", np.float64)]
    columns += [(name, kinds[kind]) for kind in RECORDED for name in names[kind]]
    result = np.zeros(len(points.times), dtype=columns)
    result["time"] = points.times
    tables: tuple[NDArray[Any], ...] = part.real_table, part.integer_table, part.boolean_table
    for kind, table in zip(RECORDED, tables, strict=True):
        for column, name in enumerate(names[kind]):
            result[name] = table[:, column]
    return result
