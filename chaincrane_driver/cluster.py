"""Runs a sweep's cases on an existing Dask cluster; needs the extra `cluster`.

FMUs and scenario travel to the workers once. Each Dask worker keeps processes of its own that run
the FMUs, as one machine does, so an FMU that crashes takes no Dask worker with it; a Dask worker
that dies gives its batch back, and another one does it. Cases go in batches of about a second, a
few of them under way at a time, so that neither the scheduler nor the client is swamped.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Generator, Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from queue import Empty, LifoQueue
from time import monotonic
from typing import Any

from .errors import UserError, one_line
from .processes import Workers
from .subjects import Outcome, Subject
from .sweep import Numbered, Scheduler, outcomes, read_fmus, unpacked

INSTALL = "pip install 'chaincrane[cluster]'"
BATCH_TIME = 1.0  # s, that a batch should take
MOST_AT_ONCE = 2000  # cases in a batch
AHEAD = 2  # batches that each thread of the cluster is given at a time
DEATHS = 10  # workers that a batch may lose before the sweep gives up
CONNECT = 10.0  # s, to find the scheduler


@dataclass(frozen=True)
class Parcel:
    """What travels to the workers once."""

    key: str  # another sweep's is another
    subject: Subject
    fmus: Mapping[str, bytes]


@dataclass(frozen=True)
class Batch:
    """What comes back of some cases, and how long they took, s."""

    outcomes: list[tuple[int, Outcome]]
    seconds: float


class Station:
    """A process that runs FMUs for a thread of a Dask worker."""

    def __init__(self, parcel: Parcel) -> None:
        self._stack = ExitStack()
        folder = self._stack.enter_context(
            tempfile.TemporaryDirectory(prefix="chaincrane-fmus-", ignore_cleanup_errors=True)
        )
        self._subject = unpacked(parcel.subject, parcel.fmus, Path(folder))
        self._workers = self._stack.enter_context(Workers(1))

    def run(self, cases: Iterable[Numbered]) -> list[tuple[int, Outcome]]:
        """Run cases."""
        return list(outcomes(self._workers, self._subject, cases))

    def close(self) -> None:
        """End the process."""
        self._stack.close()


_idle: dict[str, LifoQueue[Station]] = {}  # of this process, by parcel


def run_batch(parcel: Parcel, cases: list[Numbered]) -> Batch:
    """Run cases in a Dask worker, with a station that is kept for the next batch."""
    begun = monotonic()
    for key in [key for key in _idle if key != parcel.key]:
        _close(_idle.pop(key))
    idle = _idle.setdefault(parcel.key, LifoQueue())
    try:
        station = idle.get_nowait()
    except Empty:
        station = Station(parcel)
    try:
        found = station.run(cases)
    except BaseException:
        station.close()
        raise
    idle.put(station)
    return Batch(found, monotonic() - begun)


def _close(stations: LifoQueue[Station]) -> None:
    while not stations.empty():
        stations.get().close()


def dask(address: str) -> Scheduler:
    """Runs cases on the cluster whose scheduler has this address. Raises UserError."""

    def schedule(
        subject: Subject, cases: Iterable[Numbered]
    ) -> Generator[tuple[int, Outcome], None, None]:
        distributed = _distributed()
        try:
            client = distributed.Client(address, timeout=CONNECT, set_as_default=False)
        except (OSError, ValueError) as error:
            raise UserError(
                f"--scheduler {address}: no Dask scheduler there: {one_line(error)}"
            ) from error
        with client:
            parcel = Parcel(os.urandom(8).hex(), subject, read_fmus(subject))
            sent = client.scatter(parcel, broadcast=True, hash=False)
            yield from _stream(distributed, client, sent, iter(cases))

    return schedule


def _stream(
    distributed: Any, client: Any, parcel: Any, cases: Iterator[Numbered]
) -> Iterator[tuple[int, Outcome]]:
    """Submit batches, a few ahead, and give what comes of them; batches grow to their time."""
    size = 1
    coming = distributed.as_completed(loop=client.loop, raise_errors=False)
    under_way: dict[str, tuple[list[Numbered], int]] = {}  # by future: cases, deaths

    def submit(batch: list[Numbered], deaths: int = 0) -> None:
        future = client.submit(run_batch, parcel, batch, pure=False)
        under_way[future.key] = batch, deaths
        coming.add(future)

    def fill() -> None:
        threads = sum(client.nthreads().values())
        while len(under_way) < max(1, AHEAD * threads):
            batch = list(islice(cases, size))
            if not batch:
                return
            submit(batch)

    fill()
    for future in coming:
        batch, deaths = under_way.pop(future.key)
        error = None if future.status == "finished" else future.exception()
        if error is None:
            result: Batch = future.result()
            yield from result.outcomes
            if result.seconds < BATCH_TIME / 2 and len(batch) == size:
                size = min(2 * size, MOST_AT_ONCE)
            elif result.seconds > 2 * BATCH_TIME:
                size = max(1, min(size, len(batch) // 2))
        elif isinstance(error, distributed.scheduler.KilledWorker) and deaths < DEATHS:
            submit(batch, deaths + 1)  # the FMUs run in processes of their own: it is not they
        else:
            raise UserError(f"the cluster: {type(error).__name__}: {one_line(error)}")
        future.release()
        fill()


def _distributed() -> Any:
    try:
        import distributed
    except ImportError as error:
        raise UserError(f"--scheduler needs distributed, which is not here: {INSTALL}") from error
    return distributed
