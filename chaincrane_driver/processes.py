"""Work goes to a few workers, processes that keep their FMUs, and comes back as it is done.

An FMU is somebody's binary: in a process of its own it cannot take this one down with it. A worker
that dies is replaced. The run that it was at is tried once more, by a worker that has nothing else
to do: if that dies too, the run is what kills it, and it alone has failed.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import tempfile
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from time import monotonic
from typing import Any, Protocol

from tqdm import tqdm

from .errors import UserError
from .worker import AT, DONE, READY, Work

SLOW = 1.0  # s, work that takes longer than this gets a progress bar
MINUTE = 60.0  # s, from line to line where there is no terminal
BATCH_TIME = 0.1  # s, that a batch of work should take at least
LISTEN = 0.5  # s
ONE_THREAD = {"OMP_NUM_THREADS": "1"}  # a worker a core: no threads of BLAS beside them
STILLBORN = 2  # workers that may die before they are ready, one after the other
MOST_AT_ONCE = 256  # pieces of work in a batch

Numbered = tuple[int, Work]


class Timed(Work, Protocol):
    """Work of a simulated time that is known."""

    @property
    def stop_time(self) -> float:
        """Simulated time, s."""


class Failure(str):
    """Why a piece of work gave nothing."""


def progress_bar(**more: Any) -> tqdm[Any]:
    """A bar for work that takes a while; where there is no terminal, in CI say, a line a minute."""
    if sys.stderr.isatty():
        return tqdm(delay=SLOW, leave=False, **more)
    more["bar_format"] = "{desc}: {percentage:.0f} % after {elapsed}\n"
    return tqdm(delay=MINUTE, mininterval=MINUTE, maxinterval=MINUTE, leave=False, **more)


def cores() -> int:
    """Processors that this process may use."""
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Worker:
    """A worker's process, and what it has been sent and has not answered yet, in order."""

    def __init__(self, folder: Path, heard: SimpleQueue[Any]) -> None:
        path = [str(Path(one or ".").absolute()) for one in sys.path]
        code = f"import sys; sys.path[:] = {path!r}\nfrom chaincrane_driver.worker import main\n"
        code += f"main({str(folder)!r})"
        self._words = folder.with_suffix(".txt")
        with self._words.open("wb") as words:
            self.process = subprocess.Popen(
                [sys.executable, "-c", code],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=words,
                env={**ONE_THREAD, **os.environ},
            )
        self.sent: deque[Numbered] = deque()
        self.ready = False
        self.alone = False  # it is at work that is to have it for itself
        self.leaving = False
        self.batch = 1
        self.sent_at = 0.0
        Thread(target=self._listen, args=(heard,), daemon=True).start()

    def _listen(self, heard: SimpleQueue[Any]) -> None:
        """Put each message of the worker into a queue; None when it has ended."""
        stream = self.process.stdout
        assert stream is not None
        try:
            while True:
                heard.put((self, pickle.load(stream)))
        except (EOFError, pickle.UnpicklingError, OSError, ValueError):
            heard.put((self, None))

    def send(self, work: Sequence[Numbered], reports: bool) -> None:
        """Send a batch. If the worker is dead, its queue's None will tell."""
        if not self.sent:
            self.sent_at = monotonic()
        self.sent.extend(work)
        stream = self.process.stdin
        assert stream is not None
        with suppress(OSError):
            pickle.dump((reports, list(work)), stream, protocol=pickle.HIGHEST_PROTOCOL)
            stream.flush()

    def last_words(self) -> str:
        """The exit code, and the last line that it wrote as an error."""
        lines = self._words.read_text(errors="replace").split("\n")
        words = [" ".join(line.split()) for line in lines if line.strip()]
        return ": ".join([f"exit code {self.process.returncode}", *words[-1:]])

    def leave(self) -> None:
        """Let the process go, if it has nothing to do: it removes what it has unpacked."""
        if self.ready and not self.sent:
            assert self.process.stdin is not None
            with suppress(OSError):
                self.process.stdin.close()
            self.leaving = True

    def end(self) -> None:
        """Stop the process, whatever it is at."""
        if self.leaving:
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(LISTEN)
        self.process.kill()
        self.process.wait()
        for stream in (self.process.stdin, self.process.stdout):
            assert stream is not None
            with suppress(OSError):
                stream.close()


class Workers:
    """Up to ``count`` workers, started when there is work for them; a context, which ends them."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._heard: SimpleQueue[Any] = SimpleQueue()
        self._workers: list[Worker] = []
        self._started = self._stillborn = 0

    def __enter__(self) -> Workers:
        self._folder = tempfile.TemporaryDirectory(prefix="chaincrane-", ignore_cleanup_errors=True)
        return self

    def start(self, count: int) -> None:
        """Start so many workers, before there is work for them."""
        while len(self._workers) < min(count, self._count):
            self._start()

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.leave()  # side by side
        for worker in self._workers:
            worker.end()
        self._workers.clear()
        self._folder.cleanup()

    def run(
        self, work: Iterable[Numbered], on_time: Callable[[int, float], None] | None = None
    ) -> Iterator[tuple[int, Any]]:
        """Do all work; what each piece gave, or a Failure, by its number, as it is done.

        ``work`` is taken as it is needed, so there may be any amount of it. ``on_time`` is told the
        time that a run has reached, s, by number.
        """
        self._reports = on_time is not None
        waiting, again = iter(work), deque[Numbered]()
        for worker in self._workers:
            worker.batch = 1  # what was quick before says nothing of this
        tried: set[int] = set()
        self._hand_out(waiting, again)
        while any(worker.sent for worker in self._workers):
            try:
                worker, message = self._heard.get(timeout=LISTEN)
            except Empty:  # Windows takes note of Ctrl-C only now
                continue
            if worker not in self._workers:
                continue  # the last word of one that was ended
            if message is None:
                yield from self._mourn(worker, again, tried)
            else:
                kind, number, content = message
                if kind == READY:
                    worker.ready, self._stillborn = True, 0
                elif kind == AT:
                    if on_time is not None:
                        on_time(number, content)
                else:
                    worker.sent.popleft()
                    if not worker.sent:
                        self._grow(worker)
                        if worker.alone:
                            self._dismiss(worker)
                    yield number, content if kind == DONE else Failure(content)
            self._hand_out(waiting, again)

    def _hand_out(self, waiting: Iterator[Numbered], again: deque[Numbered]) -> None:
        """Give workers what they have room for, first what is to be tried again."""
        for place in range(self._count):
            if place < len(self._workers):
                worker = self._workers[place]
                if worker.alone or len(worker.sent) > worker.batch // 2:
                    continue
            else:
                worker = None
            batch = self._next(worker, waiting, again)
            if not batch:
                continue
            if worker is None:
                worker = self._start()
            worker.alone = _alone(batch[0])
            worker.send(batch, self._reports)

    def _next(
        self, worker: Worker | None, waiting: Iterator[Numbered], again: deque[Numbered]
    ) -> list[Numbered]:
        """The next batch for a worker; for None, one that is still to be started."""
        if again:
            idle = worker is None or not worker.sent
            return [again.popleft()] if idle else []
        batch: list[Numbered] = []
        for one in waiting:
            if _alone(one) and (batch or (worker is not None and worker.sent)):
                again.append(one)
                break
            batch.append(one)
            if _alone(one) or len(batch) >= (1 if worker is None else worker.batch):
                break
        return batch

    def _start(self) -> Worker:
        self._started += 1
        folder = Path(self._folder.name, str(self._started))
        worker = Worker(folder, self._heard)
        self._workers.append(worker)
        return worker

    def _dismiss(self, worker: Worker) -> None:
        worker.end()
        self._workers.remove(worker)

    def _grow(self, worker: Worker) -> None:
        """Send more at once to a worker that has done a batch in less than its time."""
        if monotonic() - worker.sent_at < BATCH_TIME:
            worker.batch = min(2 * worker.batch, MOST_AT_ONCE)

    def _mourn(
        self, worker: Worker, again: deque[Numbered], tried: set[int]
    ) -> Iterator[tuple[int, Failure]]:
        """A worker has died: what it had is done anew, but for work that has killed two."""
        self._dismiss(worker)
        if not worker.ready:
            self._stillborn += 1
            if self._stillborn > STILLBORN:
                raise UserError(f"a worker process does not start: {worker.last_words()}")
            again.extend(worker.sent)
            return
        if not worker.sent:
            return
        number, work = worker.sent.popleft()
        again.extend(worker.sent)
        if number in tried:
            yield number, Failure(f"{work.name}: the FMU crashed, {worker.last_words()}")
        else:
            tried.add(number)
            again.appendleft((number, work))


# Workers that were started before it was known what for.
_early: list[Workers] = []


@contextmanager
def early_workers(count: int) -> Iterator[None]:
    """Start up to ``count`` workers now, for those who ask :func:`workers_for` some.

    They load what they need while this process does. Where they cannot be started, that is said
    when there is work for them.
    """
    with ExitStack() as stack:
        with suppress(OSError):
            workers = stack.enter_context(Workers(cores()))
            workers.start(count)
            _early.append(workers)
            stack.callback(_early.remove, workers)
        yield


def workers_for(pieces: int) -> AbstractContextManager[Workers]:
    """Workers for some pieces of work: those that were started early, or one a core, or fewer."""
    return nullcontext(_early[-1]) if _early else Workers(min(cores(), pieces))


def _alone(one: Numbered) -> bool:
    """Is this work to have a worker for itself?"""
    return bool(getattr(one[1], "alone", False))


def do_all(workers: Workers, work: Sequence[Work], label: str) -> list[Any]:
    """Do work in some workers, with a progress bar; what each piece gave, in their order.

    Raises UserError for the first that fails.
    """
    results: dict[int, Any] = {}
    with progress_bar(total=len(work), desc=label) as bar:
        for number, result in workers.run(enumerate(work)):
            if isinstance(result, Failure):
                raise UserError(result)
            results[number] = result
            bar.update()
    return [results[number] for number in range(len(work))]


def simulate_all(jobs: Sequence[Timed], label: str) -> list[Any]:
    """Run each job in one of a few workers, with a progress bar; what it gave, in the jobs' order.

    Raises UserError for the first job that fails.
    """
    results = simulate_each(jobs, label, give_up=True)
    return [result for result in results if not isinstance(result, Failure)]


def simulate_each(jobs: Sequence[Timed], label: str, give_up: bool = False) -> list[Any]:
    """The same, with a Failure for a job that fails; ``give_up``: raises UserError at the first."""
    results: dict[int, Any] = {}
    reached = dict.fromkeys(range(len(jobs)), 0.0)
    total = sum(job.stop_time for job in jobs)
    layout = "{l_bar}{bar}| {n:.1f} of {total:.1f} s simulated, {remaining} to go"
    with progress_bar(total=total, desc=label, bar_format=layout) as bar:

        def on_time(number: int, time: float) -> None:
            reached[number] = time
            bar.update(sum(reached.values()) - bar.n)

        with workers_for(len(jobs)) as workers:
            for number, result in workers.run(enumerate(jobs), on_time):
                if give_up and isinstance(result, Failure):
                    raise UserError(result)
                results[number] = result
                on_time(number, jobs[number].stop_time)
    return [results[number] for number in range(len(jobs))]
