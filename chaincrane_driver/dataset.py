"""What a sweep gives: a labelled dataset in NetCDF, a table in CSV.

The NetCDF file is an xarray Dataset, its dimensions named by what varies; the time series are
chunked, and compressed. It needs the extra `ensembles`; the table needs nothing.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import UserError
from .journal import Journal
from .places import whole_file
from .subjects import Subject
from .vary import Design

MODULES = ("xarray", "h5netcdf", "h5py")
INSTALL = "pip install 'chaincrane[ensembles]'"
RUN, TIME = "run", "time"  # dimensions beside what varies
MESSAGE = "message"  # column and variable: why a run failed, or ""
CHUNK = 1 << 20  # bytes of a chunk of time series, about
MADE_OF = "chaincrane_made_of"  # attribute: the sweep's fingerprint


@dataclass(frozen=True)
class Files:
    """Where a sweep's results are."""

    folder: Path

    @property
    def netcdf(self) -> Path:
        """The dataset."""
        return self.folder / "sweep.nc"

    @property
    def table(self) -> Path:
        """The table."""
        return self.folder / "sweep.csv"

    @property
    def made_of(self) -> Path:
        """What the results depend on; written last, so where it is they are whole."""
        return self.folder / "sweep.json"

    def complete(self, fingerprint: Mapping[str, str]) -> bool:
        """Are the results of this very sweep here? Raises UserError if they are another's."""
        if not self.made_of.exists():
            return False
        try:
            known = json.loads(self.made_of.read_text())
            changed = [
                name
                for name in {**known, **fingerprint}
                if known.get(name) != fingerprint.get(name)
            ]
        except (ValueError, AttributeError):
            raise UserError(f"{self.made_of}: damaged; --anew discards what is here") from None
        if changed:
            raise UserError(
                f"{self.folder}: has results of another sweep: {', '.join(changed)} changed;"
                " give another --out, or --anew to discard them"
            )
        return True

    def discard(self) -> None:
        """Delete them."""
        for path in (self.made_of, self.netcdf, self.table):
            path.unlink(missing_ok=True)


@dataclass(frozen=True)
class Results:
    """Metrics of all cases: ``values`` by case, run and metric; ``messages`` by case and run."""

    values: NDArray[np.float64]
    messages: NDArray[np.object_]

    @property
    def failed(self) -> int:
        """Runs that gave nothing."""
        return int(np.count_nonzero(self.messages))


def require(module: str) -> Any:
    """A module of the extra `ensembles`. Raises UserError."""
    try:
        return import_module(module)
    except ImportError as error:
        raise UserError(f"{module} is needed for NetCDF, but is not here: {INSTALL}") from error


def collect(subject: Subject, design: Design, book: Journal) -> Results:
    """The metrics that a journal has."""
    shape = len(design), len(subject.runs), len(subject.metrics)
    values = np.full(shape, np.nan)
    messages = np.full(shape[:2], "", dtype=object)
    for number, metrics, said in book.metrics():
        values[number] = np.frombuffer(metrics).reshape(shape[1:])
        if said:
            messages[number] = said
    return Results(values, messages)


def write(
    files: Files, subject: Subject, design: Design, book: Journal, made_of: Mapping[str, str]
) -> None:
    """Write all files; each is whole or not there. Raises UserError, OSError."""
    results = collect(subject, design, book)
    write_csv(files.table, subject, design, results)
    if has_netcdf():
        partial = files.netcdf.with_suffix(".writing")
        try:
            write_netcdf(partial, subject, design, results, made_of)
            if subject.kept:
                write_series(partial, subject, design, book)
            partial.replace(files.netcdf)
        except OSError as error:
            partial.unlink(missing_ok=True)
            reason = error.strerror or " ".join(str(error).split())
            raise UserError(f"{files.netcdf}: cannot be written: {reason}") from error
    text = json.dumps(dict(made_of), indent=1)
    with whole_file(files.made_of) as partial:
        partial.write_text(text + "\n")


def require_all() -> None:
    """Raises UserError where the extra `ensembles` is not here."""
    for module in MODULES:
        require(module)


def has_netcdf() -> bool:
    """Is the extra `ensembles` here?"""
    try:
        require_all()
    except UserError:
        return False
    return True


def write_csv(path: Path, subject: Subject, design: Design, results: Results) -> None:
    """A row for each run of each case: its values, its metrics, its message. Raises OSError."""
    with whole_file(path) as partial, partial.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        names = [metric.name for metric in subject.metrics]
        writer.writerow([*design.names, RUN, *names, MESSAGE])
        for number, case in design.cases():
            for place, run in enumerate(subject.runs):
                metrics = results.values[number, place]
                row = ["" if np.isnan(one) else repr(float(one)) for one in metrics]
                message = results.messages[number, place]
                writer.writerow([*(case[name] for name in design.names), run, *row, message])


def read_csv(path: Path, subject: Subject, design: Design) -> Results:
    """What :func:`write_csv` wrote. Raises UserError."""
    shape = len(design), len(subject.runs), len(subject.metrics)
    values = np.full(shape, np.nan)
    messages = np.full(shape[:2], "", dtype=object)
    first = len(design.names) + 1
    try:
        with path.open(newline="") as file:
            rows = csv.reader(file)
            next(rows)
            for place, row in enumerate(rows):
                number, run = divmod(place, shape[1])
                values[number, run] = [float(text or "nan") for text in row[first:-1]]
                messages[number, run] = row[-1]
    except (OSError, StopIteration, ValueError, IndexError):
        raise UserError(f"{path}: damaged; --anew makes it again") from None
    return Results(values, messages)


def to_dataset(
    subject: Subject, design: Design, results: Results, made_of: Mapping[str, str]
) -> Any:
    """The metrics as an xarray Dataset, without time series."""
    xarray = require("xarray")
    sizes = design.dimensions
    shape, dimensions = tuple(sizes.values()), (*sizes, RUN)
    coordinates: dict[str, Any] = {RUN: (RUN, list(subject.runs))}
    for name in design.names:
        values = np.array(design.values(name))
        along = design.rows if name in design.table else name
        coordinates[name] = (along, values, {"units": subject.units.get(name, "")})
    if design.table:
        coordinates[design.rows] = (design.rows, np.arange(sizes[design.rows]))
    variables: dict[str, Any] = {
        metric.name: (
            dimensions,
            results.values[:, :, place].reshape(*shape, -1),
            {"units": metric.unit, "long_name": metric.meaning},
        )
        for place, metric in enumerate(subject.metrics)
    }
    about = {"long_name": "why a run failed, or nothing"}
    messages = results.messages.astype(str).reshape(*shape, -1)
    variables[MESSAGE] = (dimensions, messages, about)
    return xarray.Dataset(
        variables, coordinates, {"title": "chaincrane sweep", MADE_OF: json.dumps(dict(made_of))}
    )


def write_netcdf(
    path: Path, subject: Subject, design: Design, results: Results, made_of: Mapping[str, str]
) -> None:
    """Write the metrics. Raises OSError."""
    to_dataset(subject, design, results, made_of).to_netcdf(path, engine="h5netcdf")


def write_series(path: Path, subject: Subject, design: Design, book: Journal) -> None:
    """Add the time series to the metrics' file, a block of cases at a time. Raises OSError."""
    h5netcdf = require("h5netcdf")
    times = subject.times()
    sizes = design.dimensions
    shape = tuple(sizes.values())
    one = (len(subject.runs), len(subject.kept), len(times))
    with h5netcdf.File(path, "a") as file:
        file.dimensions[TIME] = len(times)
        axis = file.create_variable(TIME, (TIME,), float, data=times)
        axis.attrs["units"] = "s"
        variables = []
        for signal in subject.kept:
            chunks = (*_chunk(shape, 8 * len(times)), 1, len(times))
            made = file.create_variable(
                signal,
                (*sizes, RUN, TIME),
                float,
                chunks=chunks,
                compression="gzip",
                compression_opts=1,
                shuffle=True,
                fillvalue=np.nan,
            )
            made.attrs["units"] = subject.units.get(signal, "")
            variables.append(made)
        for first, block in _blocks(book, shape, one):
            for place, variable in enumerate(variables):
                rows = block[:, :, place]
                variable[first] = rows.reshape(variable[first].shape)


def _chunk(shape: tuple[int, ...], bytes_each: int) -> tuple[int, ...]:
    """A chunk of cases, as many of the last dimension as fit."""
    last = max(1, min(shape[-1], CHUNK // bytes_each)) if shape else 1
    return (*(1 for _ in shape[:-1]), last)


def _blocks(
    book: Journal, shape: tuple[int, ...], one: tuple[int, ...]
) -> Iterator[tuple[tuple[Any, ...], NDArray[np.float64]]]:
    """The series by blocks of cases that are neighbours along the last dimension: where, what."""
    last = shape[-1]
    most = max(1, min(last, CHUNK // (8 * prod(one))) * 8)
    start = 0
    rows: list[NDArray[np.float64]] = []

    def where(start: int, count: int) -> tuple[Any, ...]:
        *outer, first = map(int, np.unravel_index(start, shape))
        return (*outer, slice(first, first + count))

    for number, content in book.series():
        row = np.full(one, np.nan) if content is None else np.frombuffer(content).reshape(one)
        if rows and (len(rows) >= most or number % last == 0):
            yield where(start, len(rows)), np.array(rows)
            rows = []
        if not rows:
            start = number
        rows.append(row)
    if rows:
        yield where(start, len(rows)), np.array(rows)
