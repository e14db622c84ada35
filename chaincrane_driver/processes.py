"""Work runs in processes of its own, a few at a time, and a bar shows how far it is."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Protocol, cast

import numpy as np
from tqdm import tqdm

from .errors import UserError, one_line
from .progress import Progress
from .tables import Table

SLOW = 1.0  # s, work that takes longer than this gets a progress bar


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
        pipe.send(f"{job.name}: {one_line(error)}")
    pipe.close()
    os._exit(0)  # at a normal exit the interpreter would unload the FMU's own Python: it may crash
