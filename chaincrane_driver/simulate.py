"""FMPy drives one FMU file and gives back its outputs by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from fmpy import read_model_description, simulate_fmu
from fmpy.model_description import ModelDescription

from .errors import UserError, instead, one_line
from .progress import REPORTS, Progress
from .start_values import check_start_values
from .tables import Table, column_names


@dataclass(frozen=True)
class Job:
    """One simulation from 0 to ``stop_time`` s, with a result row per ``output_interval`` s.

    ``inputs`` follows FMPy's convention: linear between rows, a repeated time row is a jump. Its
    unknown columns, like unknown ``start_values``, are errors.
    """

    fmu: Path
    start_values: Mapping[str, Any]
    inputs: Table | None
    stop_time: float
    output_interval: float

    @property
    def name(self) -> str:
        """What messages call it."""
        return str(self.fmu)

    def run(self, progress: Progress) -> Table:
        """Simulate in this process; ``progress`` is told the time reached. Raises UserError."""
        return simulate(self, progress)


def describe(fmu: Path) -> ModelDescription:
    """The FMU's model description, validated by FMPy. Raises UserError."""
    if not fmu.exists():
        raise UserError(f"{fmu}: no such FMU; build it with: chaincrane build")
    try:
        return read_model_description(str(fmu))
    except Exception as error:
        raise UserError(f"{fmu}: not a valid FMU: {one_line(error)}") from error


def simulate(job: Job, progress: Progress = lambda time: None) -> Table:
    """Simulate in this process; ``progress`` is told the time reached. Raises UserError."""
    fmu = job.fmu
    description = describe(fmu)
    check_start_values(fmu, description, job.start_values)
    log: list[str] = []

    def keep(env: Any, instance: bytes, status: int, category: bytes, message: bytes) -> None:
        log.append(message.decode(errors="replace"))

    reported = 0.0

    def report(time: float, _recorder: Any) -> bool:
        nonlocal reported
        if time - reported >= job.stop_time / REPORTS:
            reported = time
            progress(time)
        return True

    try:
        result = simulate_fmu(
            str(fmu),
            model_description=description,
            start_values=dict(job.start_values),
            input=_with_all_inputs(fmu, description, job.inputs),
            start_time=0.0,
            stop_time=job.stop_time,
            output_interval=job.output_interval,
            step_finished=report,
            logger=keep,
            debug_logging=True,
        )
    except UserError:
        raise
    except Exception as error:
        raise UserError(f"{fmu}: {log[-1] if log else one_line(error)}") from error
    reached = float(result["time"][-1])
    if reached < job.stop_time - 1e-9:  # FMPy ends quietly where a step is discarded
        reason = log[-1] if log else "the FMU gives no reason"
        raise UserError(f"{fmu}: stopped at {reached:g} s of {job.stop_time:g} s: {reason}")
    return np.array(result)


def _with_all_inputs(fmu: Path, description: ModelDescription, inputs: Table | None) -> Table:
    """The input table with a column for each of the FMU's inputs, zero where none was given."""
    names = [v.name for v in description.modelVariables if v.causality == "input"]
    time = np.zeros(1) if inputs is None else inputs[column_names(inputs)[0]]
    table = np.zeros(len(time), dtype=[(name, float) for name in ["time", *names]])
    table["time"] = time
    if inputs is not None:
        for name in column_names(inputs)[1:]:
            if name not in names:
                raise UserError(f"{fmu}: {name!r} is not an input{instead(name, names)}")
            table[name] = inputs[name]
    return table
