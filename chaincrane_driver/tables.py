"""Tables of inputs and results, and their CSV files."""

from __future__ import annotations

import contextlib
import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .errors import UserError
from .places import whole_file

Table = NDArray[np.void]  # a structured array, its first column the time


def column_names(table: Table) -> tuple[str, ...]:
    """The names of a table's columns, in order."""
    assert table.dtype.names is not None
    return table.dtype.names


def read_table(path: Path) -> Table:
    """Read a CSV file of numbers with a header, its first column the time.

    Where semicolons stand between the values, as spreadsheets of many countries write them, a comma
    is a decimal point; a byte-order mark is passed over. Raises UserError naming the file, row and
    column of what is not a number.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not a text file"
        raise UserError(f"{path}: cannot be read: {reason}") from error
    semicolons = ";" in text.partition("\n")[0]
    lines = text.replace(",", ".").splitlines() if semicolons else text.splitlines()
    rows = [row for row in csv.reader(lines, delimiter=";" if semicolons else ",") if row]
    if len(rows) < 2:
        raise UserError(f"{path}: needs a header and at least one row of numbers")
    header = [name.strip() for name in rows[0]]
    if header[0] != "time" or len(set(header)) != len(header):
        raise UserError(f"{path}: the header needs 'time' first and no name twice")
    try:
        values = np.array(rows[1:], dtype=float)
    except ValueError:  # a word, or rows of unequal lengths
        raise _bad_cell(path, header, rows) from None
    if values.shape[1] != len(header) or not np.isfinite(values).all():
        raise _bad_cell(path, header, rows)
    table = np.zeros(len(values), dtype=[(name, float) for name in header])
    for name, column in zip(header, values.T, strict=True):
        table[name] = column
    if np.any(np.diff(table["time"]) < 0):
        raise UserError(f"{path}: the time goes backwards")
    return table


def _bad_cell(path: Path, header: Sequence[str], rows: Sequence[Sequence[str]]) -> UserError:
    """What is wrong with the first row that does not fit its header, or the first bad number."""
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(header):
            return UserError(f"{path}, row {number}: {len(row)} values for {len(header)} columns")
        for name, text in zip(header, row, strict=True):
            value = np.nan
            with contextlib.suppress(ValueError):
                value = float(text)
            if not np.isfinite(value):
                return UserError(f"{path}, row {number}, {name}: {text!r} is not a finite number")
    return UserError(f"{path}: not a table of numbers")


def write_table(path: Path, table: Table, digits: int = 16) -> None:
    """Write a table as CSV, its numbers with ``digits`` significant digits."""
    columns = column_names(table)
    lines = [",".join(columns)]
    lines += [",".join(f"{value:.{digits}g}" for value in row) for row in table.tolist()]
    with whole_file(path) as partial:
        partial.write_text("\n".join(lines) + "\n")
