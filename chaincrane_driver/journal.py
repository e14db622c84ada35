"""What a sweep has done so far, in a file that outlives a kill: a SQLite database.

Each case is in it once, whole or not at all. It knows what its results depend on, and takes no
others. While a sweep runs it has the file for itself.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .errors import UserError
from .subjects import Outcome

FILE = "sweep.partial"
FORMAT = "1"  # of the file


class Journal:
    """The cases that are done, by number; of a sweep with ``fingerprint``. Close it.

    Raises UserError where the folder has another sweep's, another sweep writes it, or it is
    damaged; every method does where the disk is full.
    """

    def __init__(self, folder: Path, fingerprint: Mapping[str, str]) -> None:
        self.path = folder / FILE
        folder.mkdir(parents=True, exist_ok=True)
        with self._errors():
            self._base = sqlite3.connect(self.path, timeout=0.0, isolation_level=None)
        try:
            with self._errors():
                self._base.execute("PRAGMA locking_mode = EXCLUSIVE")
                self._base.execute("PRAGMA journal_mode = WAL")
                self._base.execute("PRAGMA synchronous = NORMAL")
                self._base.execute("BEGIN IMMEDIATE")  # the lock lasts to the end
                self._base.execute("CREATE TABLE IF NOT EXISTS made_of (what PRIMARY KEY, hash)")
                self._base.execute(
                    "CREATE TABLE IF NOT EXISTS done"
                    " (number INTEGER PRIMARY KEY, metrics BLOB, series BLOB, messages TEXT)"
                )
                self._keep_or_compare({"format": FORMAT, **fingerprint})
                self._base.execute("COMMIT")
        except BaseException:
            self._base.close()
            raise

    def _keep_or_compare(self, fingerprint: Mapping[str, str]) -> None:
        known = dict(self._base.execute("SELECT what, hash FROM made_of"))
        if not known:
            self._base.executemany("INSERT INTO made_of VALUES (?, ?)", fingerprint.items())
            return
        changed = differing(known, fingerprint)
        if changed:
            raise UserError(
                f"{self.path.parent}: has results of another sweep: {', '.join(changed)} changed;"
                " give another --out, or --anew to discard them"
            )

    def _errors(self) -> _Errors:
        return _Errors(self.path)

    def close(self) -> None:
        """Release the file."""
        self._base.close()

    def done(self, count: int) -> NDArray[np.bool_]:
        """Which of ``count`` cases are done."""
        found = np.zeros(count, bool)
        with self._errors():
            for (number,) in self._base.execute("SELECT number FROM done"):
                found[number] = True
        return found

    def add(self, outcomes: Iterable[tuple[int, Outcome]]) -> None:
        """Keep cases, all or none; one that is there stays as it is. Raises UserError."""
        rows = [
            (
                number,
                one.metrics.astype(float).tobytes(),
                one.series.astype(float).tobytes() if one.series.size else None,
                json.dumps(one.messages) if any(one.messages) else None,
            )
            for number, one in outcomes
        ]
        with self._errors():
            self._base.execute("BEGIN IMMEDIATE")
            try:
                self._base.executemany("INSERT OR IGNORE INTO done VALUES (?, ?, ?, ?)", rows)
                self._base.execute("COMMIT")
            except BaseException:
                if self._base.in_transaction:
                    self._base.execute("ROLLBACK")
                raise

    def metrics(self) -> Iterator[tuple[int, bytes, tuple[str, ...]]]:
        """Number, metrics and messages of each case that is done."""
        with self._errors(), closing(self._base.cursor()) as cursor:
            for number, metrics, messages in cursor.execute(
                "SELECT number, metrics, messages FROM done ORDER BY number"
            ):
                yield number, metrics, tuple(json.loads(messages)) if messages else ()

    def series(self) -> Iterator[tuple[int, bytes]]:
        """Number and series of each case that is done."""
        with self._errors(), closing(self._base.cursor()) as cursor:
            yield from cursor.execute("SELECT number, series FROM done ORDER BY number")

    def discard(self) -> None:
        """Close and delete the file: its results are elsewhere."""
        self.close()
        for suffix in ("", "-wal", "-shm"):
            Path(f"{self.path}{suffix}").unlink(missing_ok=True)


class _Errors:
    """SQLite's errors as UserError."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> None:
        return None

    def __exit__(self, _kind: object, error: object, _trace: object) -> None:
        if isinstance(error, sqlite3.Error):
            said = str(error)
            if "locked" in said:
                said = "another sweep is writing into this folder"
            raise UserError(f"{self._path}: {said}") from error


def differing(known: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """What two fingerprints differ in."""
    return [what for what in dict.fromkeys([*known, *now]) if known.get(what) != now.get(what)]


def discard(folder: Path) -> None:
    """Delete a folder's journal, unless a sweep is writing it. Raises UserError."""
    path = folder / FILE
    if not path.exists():
        return
    with _Errors(path), closing(sqlite3.connect(path, timeout=0.0, isolation_level=None)) as base:
        base.execute("PRAGMA locking_mode = EXCLUSIVE")
        base.execute("BEGIN IMMEDIATE")
        base.execute("ROLLBACK")
    for suffix in ("", "-wal", "-shm"):
        Path(f"{path}{suffix}").unlink(missing_ok=True)
