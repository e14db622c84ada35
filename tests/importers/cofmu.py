"""Simulate an FMU with CoFmuPy."""

from __future__ import annotations

from typing import Any

from cofmupy import Coordinator, wrappers
from importers.case import from_command_line

MODEL = "crane"


class TypedHandler(wrappers.Fmu2Handler):  # type: ignore[misc]
    """CoFmuPy 1.0.0 sets every start value, and reads every output, as a Real."""

    def __init__(self, path: str, slave: type) -> None:
        super().__init__(path, slave)
        self.default_step_size = None  # text in newer FMPy, which CoFmuPy cannot compare

    def _set_variable(self, name: str, value: list[Any]) -> None:
        variable = self.var_name2attr[name]
        getattr(self.fmu, f"set{variable.type}")([variable.valueReference], value)

    def get_output_names(self) -> list[str]:
        """The Real ones."""
        return [n for n in super().get_output_names() if self.get_variable_type(n) == "Real"]


case = from_command_line()
wrappers.Fmu2Handler = TypedHandler
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
