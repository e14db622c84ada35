"""FMPy drives FMU files, each in a process of its own, and gives back their outputs by name."""

from __future__ import annotations

import contextlib
import csv
import multiprocessing
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np
from fmpy import read_model_description, simulate_fmu
from fmpy.model_description import ModelDescription
from numpy.typing import NDArray
from tqdm import tqdm

from .errors import UserError

Table = NDArray[np.void]  # a structured array, its first column the time

SLOW = 1.0  # s, work that takes longer than this gets a progress bar
Progress = Callable[[float], None]

REPORTS = 100  # of its progress that a simulation makes


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


class Work(Protocol):
    """Anything that runs FMUs for some simulated time, in a process of its own."""

    @property
    def name(self) -> str:
        """What messages call it."""

    @property
    def stop_time(self) -> float:
        """Simulated time, s."""

    def run(self, progress: Progress) -> Table:
        """Simulate in this process; ``progress`` is told the time reached. Raises UserError."""


def progress_bar(**more: Any) -> tqdm[Any]:
    """A bar that shows on a terminal alone, and only for work that takes a while."""
    return tqdm(delay=SLOW, leave=False, disable=None, **more)


def describe(fmu: Path) -> ModelDescription:
    """The FMU's model description, validated by FMPy. Raises UserError."""
    if not fmu.exists():
        raise UserError(f"{fmu}: no such FMU; build it with: python build_fmu.py")
    try:
        return read_model_description(str(fmu))
    except Exception as error:
        raise UserError(f"{fmu}: not a valid FMU: {_one_line(error)}") from error


def simulate(job: Job, progress: Progress = lambda time: None) -> Table:
    """Simulate in this process; ``progress`` is told the time reached. Raises UserError."""
    fmu = job.fmu
    description = describe(fmu)
    known = {variable.name for variable in description.modelVariables}
    for name in job.start_values:
        if name not in known:
            raise UserError(f"{fmu}: there is no variable {name!r} to start with")
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
        raise UserError(f"{fmu}: {log[-1] if log else _one_line(error)}") from error
    reached = float(result["time"][-1])
    if reached < job.stop_time - 1e-9:  # FMPy ends quietly where a step is discarded
        reason = log[-1] if log else "the FMU gives no reason"
        raise UserError(f"{fmu}: stopped at {reached:g} s of {job.stop_time:g} s: {reason}")
    return np.array(result)


def simulate_all(jobs: Sequence[Work], label: str) -> list[Table]:
    """Simulate each job in a process of its own, a few at a time, with a progress bar.

    An FMU is somebody's binary: alone in its process it cannot disturb another one, nor take this
    one down with it. Raises UserError for the first job that fails.
    """
    results: dict[int, Table] = {}
    waiting = list(enumerate(jobs))[::-1]
    running: dict[Connection, tuple[int, BaseProcess]] = {}
    reached = dict.fromkeys(range(len(jobs)), 0.0)
    total = sum(job.stop_time for job in jobs)
    spawn = multiprocessing.get_context("spawn")
    layout = "{l_bar}{bar}| {n:.1f} of {total:.1f} s simulated, {remaining} to go"
    with progress_bar(total=total, desc=label, bar_format=layout) as bar:
        try:
            while waiting or running:
                while waiting and len(running) < (os.cpu_count() or 1):
                    number, job = waiting.pop()
                    here, there = spawn.Pipe(duplex=False)
                    process = spawn.Process(target=_work, args=(job, there), daemon=True)
                    process.start()
                    there.close()
                    running[here] = number, process
                for ready in wait(list(running)):
                    pipe = cast(Connection, ready)
                    number, worker = running[pipe]
                    message = _receive(pipe, worker, jobs[number])
                    if isinstance(message, float):
                        reached[number] = message
                    else:
                        results[number] = message
                        reached[number] = jobs[number].stop_time
                        del running[pipe]
                bar.update(sum(reached.values()) - bar.n)
        finally:
            for _, worker in running.values():
                worker.terminate()
    return [results[number] for number in range(len(jobs))]


def _receive(pipe: Connection, process: BaseProcess, job: Work) -> float | Table:
    """The next message of a working process: the time reached, or its result."""
    try:
        message = pipe.recv()
    except EOFError:
        process.join()
        raise UserError(f"{job.name}: the FMU crashed, exit code {process.exitcode}") from None
    if isinstance(message, str):
        raise UserError(message)
    assert isinstance(message, (float, np.ndarray))
    return message


def _work(job: Work, pipe: Connection) -> None:
    """A working process: sends the times reached as numbers, then the result, or an error."""
    try:
        pipe.send(job.run(pipe.send))
    except UserError as error:
        pipe.send(str(error))
    except Exception as error:
        pipe.send(f"{job.name}: {_one_line(error)}")
    pipe.close()
    os._exit(0)  # at a normal exit the interpreter would unload the FMU's own Python: it may crash


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def _with_all_inputs(fmu: Path, description: ModelDescription, inputs: Table | None) -> Table:
    """The input table with a column for each of the FMU's inputs, zero where none was given."""
    names = [v.name for v in description.modelVariables if v.causality == "input"]
    time = np.zeros(1) if inputs is None else inputs[_columns(inputs)[0]]
    table = np.zeros(len(time), dtype=[(name, float) for name in ["time", *names]])
    table["time"] = time
    if inputs is not None:
        for name in _columns(inputs)[1:]:
            if name not in names:
                raise UserError(f"{fmu}: {name!r} is not an input; inputs are {', '.join(names)}")
            table[name] = inputs[name]
    return table


def _columns(table: Table) -> tuple[str, ...]:
    assert table.dtype.names is not None
    return table.dtype.names


def read_table(path: Path) -> Table:
    """Read a CSV file of numbers with a header, its first column the time.

    Raises UserError naming the file, row and column of what is not a number.
    """
    try:
        with path.open(newline="") as file:
            rows = [row for row in csv.reader(file) if row]
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not a text file"
        raise UserError(f"{path}: cannot be read: {reason}") from error
    if len(rows) < 2:
        raise UserError(f"{path}: needs a header and at least one row of numbers")
    header = [name.strip() for name in rows[0]]
    if header[0] != "time" or len(set(header)) != len(header):
        raise UserError(f"{path}: the header needs 'time' first and no name twice")
    table = np.zeros(len(rows) - 1, dtype=[(name, float) for name in header])
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(header):
            raise UserError(f"{path}, row {number}: {len(row)} values for {len(header)} columns")
        for name, text in zip(header, row, strict=True):
            value = np.nan
            with contextlib.suppress(ValueError):
                value = float(text)
            if not np.isfinite(value):
                raise UserError(f"{path}, row {number}, {name}: {text!r} is not a finite number")
            table[name][number - 2] = value
    if np.any(np.diff(table["time"]) < 0):
        raise UserError(f"{path}: the time goes backwards")
    return table


def write_table(path: Path, table: Table, digits: int = 16) -> None:
    """Write a table as CSV, its numbers with ``digits`` significant digits."""
    columns = _columns(table)
    lines = [",".join(columns)]
    lines += [",".join(f"{value:.{digits}g}" for value in row) for row in table.tolist()]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")
