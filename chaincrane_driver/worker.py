"""A worker: a process that runs what it is sent, with FMUs that it keeps loaded.

It reads pickles from its standard input: whether runs are to tell their time, and a list of
(number, work). It writes a message for each event to its standard output:

    READY                       once, when it can be sent work
    (AT, number, time)          the simulated time that a run has reached, s
    (DONE, number, result)      what a run gave
    (FAILED, number, message)   why it gave nothing
"""

from __future__ import annotations

import os
import pickle
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable
from time import monotonic
from typing import TYPE_CHECKING, Any, BinaryIO, Protocol

from .errors import UserError, one_line
from .progress import Progress

if TYPE_CHECKING:
    from .instances import Instances

READY, AT, DONE, FAILED = "ready", "at", "done", "failed"
PAUSE = 0.1  # s, between two messages of the time that a run has reached


class Work(Protocol):
    """Anything that runs FMUs; it travels to a worker as a pickle."""

    @property
    def name(self) -> str:
        """What messages call it."""

    def run(self, instances: Instances, progress: Progress | None = None) -> Any:
        """Run in this process; ``progress`` is told the time reached. Raises UserError."""


def attempt(
    number: int, work: Work, instances: Instances, progress: Progress | None
) -> tuple[str, int, Any]:
    """Run one piece of work; the message of its end."""
    try:
        return DONE, number, work.run(instances, progress)
    except UserError as error:
        return FAILED, number, str(error)
    except Exception as error:
        return FAILED, number, f"{work.name}: {one_line(error)}"


def serve(take: BinaryIO, tell: Callable[[Any], None]) -> None:
    """Run what comes from ``take`` until it ends."""
    from .instances import Instances  # not above: who starts workers does so before it loads FMPy

    instances = Instances()
    tell((READY, -1, None))
    while True:
        try:
            reports, batch = pickle.load(take)
        except EOFError:
            return
        for number, work in batch:
            progress = _reporter(tell, number) if reports else None
            tell(attempt(number, work, instances, progress))


def _reporter(tell: Callable[[Any], None], number: int) -> Progress:
    """What a run tells its progress; it is passed on as often as somebody can see it move."""
    told = monotonic()

    def report(time: float) -> None:
        nonlocal told
        if monotonic() - told >= PAUSE:
            told = monotonic()
            tell((AT, number, time))

    return report


def main(folder: str) -> None:
    """Serve on standard input and output; FMUs are extracted below ``folder``, a worker's own."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for who has started this one
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what an FMU prints goes where its errors go, a file of who has started this
    os.makedirs(folder, exist_ok=True)
    tempfile.tempdir = folder

    def tell(message: Any) -> None:
        pickle.dump(message, out, protocol=pickle.HIGHEST_PROTOCOL)
        out.flush()

    try:
        serve(sys.stdin.buffer, tell)
    except BrokenPipeError:
        pass  # nobody listens any more
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os._exit(0)  # at a normal exit the FMUs' libraries, anybody's, end too: one may crash
