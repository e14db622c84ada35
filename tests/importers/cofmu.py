"""Simulate an FMU with CoFmuPy, which sets and reads every variable as a Real."""

from __future__ import annotations

from cofmupy import Coordinator
from importers.case import from_command_line

MODEL = "crane"


case = from_command_line()
coordinator = Coordinator()
coordinator.start({"fmus": [{"id": MODEL, "path": case.fmu, "initialization": case.start}]})


def row() -> list[float]:
    """Time and outputs now."""
    values = [coordinator.get_variable((MODEL, name))[0] for name in case.outputs]
    return [coordinator.master.current_time, *values]


rows = [row()]
changes = case.changes
for number in range(case.steps):
    inputs = {name: [value] for name, value in changes.get(number, {}).items()}
    coordinator.master.set_inputs({MODEL: inputs})
    coordinator.do_step(case.step)
    rows.append(row())
case.write(rows)
