"""What every importer is asked to do: one FMU, start values, inputs that jump, outputs to read."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Case:
    """A run from 0 to ``stop`` s in steps of ``step`` s."""

    fmu: str
    out: str  # CSV file to write
    step: float
    stop: float
    start: dict[str, Any]
    outputs: list[str]  # Real ones
    input: list[tuple[float, dict[str, float]]]  # changes, at multiples of the step

    @property
    def steps(self) -> int:
        """Number of communication steps."""
        return round(self.stop / self.step)

    @property
    def changes(self) -> dict[int, dict[str, float]]:
        """Changes of the inputs, by the number of the step that they come before."""
        return {round(time / self.step): values for time, values in self.input}

    def write(self, rows: Iterable[Sequence[float]]) -> None:
        """Write time and outputs, a row a communication point, with every digit."""
        with Path(self.out).open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["time", *self.outputs])
            writer.writerows([f"{value:.17g}" for value in row] for row in rows)


def from_command_line() -> Case:
    """The case that the first argument describes, as JSON."""
    return Case(**json.loads(sys.argv[1]))
