"""Many runs of a subject, one for each case of a design: on this machine or on a cluster.

Results go into a journal as they come, so a sweep that is stopped goes on where it was; when all
are there they become a dataset (NetCDF), a table (CSV) and a picture.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from time import monotonic

import numpy as np
from numpy.typing import NDArray

from . import dataset, journal
from .errors import UserError
from .instances import Instances
from .journal import Journal
from .processes import Failure, Workers, cores, progress_bar
from .progress import Progress
from .subjects import Outcome, Subject, digest, failed
from .vary import Case, Design

SAVED_EVERY = 0.5  # s
MOST_UNSAVED = 64 << 20  # bytes of results

Numbered = tuple[int, Case]
# Runs cases and gives what is kept of each, in any order: on this machine, or on a cluster.
Scheduler = Callable[[Subject, Iterable[Numbered]], Generator[tuple[int, Outcome], None, None]]


@dataclass(frozen=True)
class CaseRun:
    """A case as a worker's work. A batch of them is one pickle, with one subject in it."""

    subject: Subject
    case: Case

    @property
    def name(self) -> str:
        """What messages call it."""
        return ", ".join(f"{name} = {value}" for name, value in self.case.items())

    def run(self, instances: Instances, _progress: Progress | None = None) -> Outcome:
        """Run it in this process."""
        return self.subject.run(self.case, instances)


def outcomes(
    workers: Workers, subject: Subject, cases: Iterable[Numbered]
) -> Iterator[tuple[int, Outcome]]:
    """Run cases in some workers; those that fail or kill their worker have a message."""
    work = ((number, CaseRun(subject, case)) for number, case in cases)
    for number, result in workers.run(work):
        if isinstance(result, Failure):
            yield number, failed(subject, [str(result)] * len(subject.runs))
        else:
            yield number, result


def local(processes: int | None = None) -> Scheduler:
    """Runs cases in some processes of this machine, one a core if not said."""

    def schedule(
        subject: Subject, cases: Iterable[Numbered]
    ) -> Generator[tuple[int, Outcome], None, None]:
        with Workers(processes or cores()) as workers:
            yield from outcomes(workers, subject, cases)

    return schedule


def fingerprint(subject: Subject, design: Design, fmus: Mapping[str, bytes]) -> dict[str, str]:
    """All that results depend on: FMU files, scenario, what varies, what is kept."""
    varied = [(name, design.values(name)) for name in design.names]
    files = {name: sha256(content).hexdigest()[:16] for name, content in fmus.items()}
    return subject.fingerprint() | files | {"what varies": digest(varied, design.rows)}


def read_fmus(subject: Subject) -> dict[str, bytes]:
    """The subject's FMU files by name."""
    return {name: path.read_bytes() for name, path in subject.fmus.items()}


def unpacked(subject: Subject, fmus: Mapping[str, bytes], folder: Path) -> Subject:
    """The subject with its FMUs written into a folder, where nobody builds others meanwhile."""
    for name, content in fmus.items():
        (folder / name).write_bytes(content)
    return subject.with_fmus({name: folder / name for name in fmus})


def sweep(
    subject: Subject, design: Design, out: Path, schedule: Scheduler, anew: bool = False
) -> dataset.Files:
    """Run all cases that ``out`` has not got yet, and write what they gave; the files' paths.

    Raises UserError; what is done until then, or until Ctrl-C, is kept, and the same call goes on
    from there.
    """
    subject.check(design)
    fmus = read_fmus(subject)
    made_of = fingerprint(subject, design, fmus)
    files = dataset.Files(out)
    if anew:
        journal.discard(out)
        files.discard()
    elif files.complete(made_of):
        return files
    with tempfile.TemporaryDirectory(prefix="chaincrane-fmus-") as folder:
        private = unpacked(subject, fmus, Path(folder))
        book = Journal(out, made_of)
        try:
            _run(private, design, book, schedule)
            dataset.write(files, subject, design, book, made_of)
            book.discard()
        except KeyboardInterrupt:
            kept = int(book.done(len(design)).sum())
            raise UserError(
                f"stopped: {kept} of {len(design)} cases are kept in {out};"
                " the same command goes on from there"
            ) from None
        finally:
            book.close()
    return files


def _run(subject: Subject, design: Design, book: Journal, schedule: Scheduler) -> None:
    """Run what is not done, and keep it."""
    done = book.done(len(design))
    left = ((number, case) for number, case in _cases(design, done))
    fresh: list[tuple[int, Outcome]] = []
    saved = monotonic()
    with progress_bar(total=len(design), initial=int(done.sum()), desc="sweep", unit="run") as bar:
        try:
            if done.all():
                return
            with closing(schedule(subject, left)) as coming:
                for number, outcome in coming:
                    fresh.append((number, outcome))
                    bar.update()
                    size = sum(one.series.nbytes for _, one in fresh[-1:]) * len(fresh)
                    if monotonic() - saved > SAVED_EVERY or size > MOST_UNSAVED:
                        book.add(fresh)
                        fresh.clear()
                        saved = monotonic()
            book.add(fresh)
            fresh.clear()
        except BaseException:
            if fresh:
                _try_to_keep(book, fresh)
            raise


def _try_to_keep(book: Journal, fresh: list[tuple[int, Outcome]]) -> None:
    """Keep what there is while another error is on its way out."""
    try:
        book.add(fresh)
    except UserError:
        return


def _cases(design: Design, done: NDArray[np.bool_]) -> Iterator[Numbered]:
    """The cases that are not done."""
    return ((int(number), design.case(int(number))) for number in np.flatnonzero(~done))
