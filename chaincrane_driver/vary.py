"""What varies in a sweep: its grammar, and the cases that it makes.

    NAME=0.05:0.5:50            50 values from 0.05 to 0.5
    NAME=0.01:10:40:log         evenly spaced logarithms
    NAME=2,5,10                 these
    NAME=uniform(0.05,0.5)      random, as often as --samples says
    NAME=loguniform(0.01,10)
    NAME=normal(0.42,0.02)      mean and standard deviation

Values and ranges make a grid, every one with every other; the random ones are drawn together, and
each draw is run at each point of the grid. A CSV file of cases takes the place of the draws.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, prod
from pathlib import Path
from typing import Any

import numpy as np

from .errors import UserError

METHODS = ("random", "lhs", "sobol")
DISTRIBUTIONS = ("uniform", "loguniform", "normal")
EDGE = 1e-15  # of probability
_RANDOM = re.compile(r"(\w+)\(([^,()]+),([^,()]+)\)")
_EXAMPLE = "payload.mass=0.05:0.5:50, chain.elements=2,5,10 or payload.mass=normal(0.42,0.02)"

Case = dict[str, Any]  # values by name


@dataclass(frozen=True)
class Axis:
    """A variable and the values that it takes, a dimension of the grid."""

    name: str
    values: tuple[Any, ...]


@dataclass(frozen=True)
class Distribution:
    """A variable that is drawn: by kind its limits, or its mean and standard deviation."""

    name: str
    kind: str
    first: float
    second: float

    def quantile(self, p: np.ndarray) -> np.ndarray:
        """The values below which it lies with probabilities ``p``."""
        if self.kind == "uniform":
            return np.asarray(self.first + p * (self.second - self.first))
        if self.kind == "loguniform":
            low, high = np.log(self.first), np.log(self.second)
            return np.asarray(np.exp(low + p * (high - low)))
        from scipy.special import ndtri

        inside = np.clip(p, EDGE, 1.0 - EDGE)  # a normal variable has no ends
        return np.asarray(self.first + self.second * ndtri(inside))


@dataclass(frozen=True)
class Design:
    """The cases of a sweep: a grid of axes, and at each of its points the rows of a table.

    ``table`` has columns by name, all of one length; the dimension of its rows is ``rows``.
    """

    axes: tuple[Axis, ...]
    table: Mapping[str, tuple[Any, ...]]
    rows: str = "sample"

    @property
    def dimensions(self) -> dict[str, int]:
        """Sizes of the dimensions by name, the last varying fastest."""
        sizes = {axis.name: len(axis.values) for axis in self.axes}
        if self.table:
            sizes[self.rows] = len(next(iter(self.table.values())))
        return sizes

    @property
    def names(self) -> tuple[str, ...]:
        """All that varies."""
        return (*(axis.name for axis in self.axes), *self.table)

    def __len__(self) -> int:
        return prod(self.dimensions.values())

    def values(self, name: str) -> tuple[Any, ...]:
        """The values of a name, along its own dimension."""
        for axis in self.axes:
            if axis.name == name:
                return axis.values
        return self.table[name]

    def case(self, number: int) -> Case:
        """The values of one case."""
        sizes = self.dimensions
        places = np.unravel_index(number, tuple(sizes.values())) if sizes else ()
        at = dict(zip(sizes, map(int, places), strict=True))
        found = {axis.name: axis.values[at[axis.name]] for axis in self.axes}
        return found | {name: column[at[self.rows]] for name, column in self.table.items()}

    def cases(self) -> Iterator[tuple[int, Case]]:
        """All cases by number, made as they are asked for."""
        return ((number, self.case(number)) for number in range(len(self)))


def parse(text: str) -> Axis | Distribution:
    """One ``--vary NAME=WHAT``. Raises UserError."""
    name, equals, what = text.partition("=")
    name, what = name.strip(), what.strip()
    if not equals or not name or not what:
        raise UserError(f"--vary {text!r} is not like {_EXAMPLE}")
    random = _RANDOM.fullmatch(what)
    if random:
        kind, first, second = random.groups()
        return _distribution(text, name, kind, _number(text, first), _number(text, second))
    if ":" in what:
        return Axis(name, _range(text, what.split(":")))
    values = tuple(value(one) for one in what.split(","))
    if len(set(values)) < len(values):
        raise UserError(f"--vary {text!r} has a value twice")
    return Axis(name, values)


def value(text: str) -> Any:
    """A number if it is one, else the text."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text.strip()


def _number(text: str, one: str) -> int | float:
    found = value(one)
    if not isinstance(found, (int, float)) or not isfinite(found):
        raise UserError(f"--vary {text!r}: {one.strip()!r} is not a finite number")
    return found


def _range(text: str, parts: Sequence[str]) -> tuple[float, ...]:
    if len(parts) not in (3, 4) or (len(parts) == 4 and parts[3] != "log"):
        raise UserError(f"--vary {text!r}: a range is FIRST:LAST:COUNT or FIRST:LAST:COUNT:log")
    first, last = (_number(text, one) for one in parts[:2])
    count = value(parts[2])
    if not isinstance(count, int) or count < 2 or first == last:
        raise UserError(f"--vary {text!r}: a range needs two ends and a count of 2 or more")
    if len(parts) == 3:
        step = (last - first) / (count - 1)
        if isinstance(first, int) and isinstance(last, int) and step.is_integer():
            return tuple(first + int(step) * place for place in range(count))
        return tuple(np.linspace(first, last, count).tolist())
    if not (first > 0.0 and last > 0.0):
        raise UserError(f"--vary {text!r}: a logarithmic range needs ends above 0")
    return tuple(np.geomspace(first, last, count).tolist())


def _distribution(text: str, name: str, kind: str, first: float, second: float) -> Distribution:
    if kind not in DISTRIBUTIONS:
        raise UserError(f"--vary {text!r}: {kind} is none of {', '.join(DISTRIBUTIONS)}")
    if kind == "normal" and not second > 0.0:
        raise UserError(f"--vary {text!r}: the standard deviation must be above 0")
    if kind != "normal" and not first < second:
        raise UserError(f"--vary {text!r}: the first limit must be below the second")
    if kind == "loguniform" and not first > 0.0:
        raise UserError(f"--vary {text!r}: limits must be above 0")
    return Distribution(name, kind, first, second)


def design(
    varied: Sequence[str],
    samples: int | None = None,
    method: str = "random",
    seed: int = 0,
    cases: Path | None = None,
) -> Design:
    """The cases of the command line's ``--vary``, ``--samples`` and ``--cases``. Raises UserError.

    ``method``: independent draws, a Latin hypercube, or Sobol's sequence, scrambled; from ``seed``.
    """
    parsed = [parse(text) for text in varied]
    axes = tuple(one for one in parsed if isinstance(one, Axis))
    random = [one for one in parsed if isinstance(one, Distribution)]
    if random and cases is not None:
        raise UserError("--cases takes the place of random variables: give one or the other")
    if random and (samples is None or samples < 1):
        raise UserError("random variables need --samples, a number of 1 or more")
    if samples is not None and not random:
        raise UserError("--samples is for random variables: give one by --vary NAME=uniform(A,B)")
    table: dict[str, tuple[Any, ...]] = {}
    rows = "sample"
    if cases is not None:
        table, rows = read_cases(cases), "case"
    elif random and samples is not None:
        table = draw(random, samples, method, seed)
    found = Design(axes, table, rows)
    if not found.names:
        raise UserError(f"nothing varies: give --vary {_EXAMPLE}, or --cases FILE")
    for name in found.names:
        if found.names.count(name) > 1:
            raise UserError(f"{name} is varied twice")
    return found


def draw(
    random: Sequence[Distribution], samples: int, method: str, seed: int
) -> dict[str, tuple[float, ...]]:
    """``samples`` values of each variable, drawn together."""
    if method == "random":
        points = np.random.default_rng(seed).random((samples, len(random)))
    else:
        from scipy.stats import qmc

        generator = np.random.default_rng(seed)
        if method == "lhs":
            points = qmc.LatinHypercube(len(random), seed=generator).random(samples)
        else:
            # drawn to the next power of 2, which Sobol's sequence is balanced for
            whole = 1 << (samples - 1).bit_length()
            points = qmc.Sobol(len(random), seed=generator).random(whole)[:samples]
    return {
        one.name: tuple(one.quantile(points[:, place]).tolist()) for place, one in enumerate(random)
    }


def read_cases(path: Path) -> dict[str, tuple[Any, ...]]:
    """A CSV file of cases: names in its header, a case in each row. Raises UserError."""
    try:
        with path.open(newline="") as file:
            lines = [line for line in csv.reader(file) if line]
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not a text file"
        raise UserError(f"{path}: cannot be read: {reason}") from error
    if len(lines) < 2:
        raise UserError(f"{path}: needs a header of names and at least one row")
    header = [name.strip() for name in lines[0]]
    if len(set(header)) < len(header) or not all(header):
        raise UserError(f"{path}: the header needs a name for each column, and none twice")
    for place, line in enumerate(lines[1:], start=2):
        if len(line) != len(header):
            raise UserError(f"{path}, row {place}: {len(line)} values for {len(header)} columns")
    return {
        name: tuple(value(line[column]) for line in lines[1:]) for column, name in enumerate(header)
    }
