"""Simulate an FMU with libcosim (DNV, Open Simulation Platform)."""

from __future__ import annotations

from importers.case import from_command_line
from libcosimpy.CosimEnums import CosimVariableType
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
from libcosimpy.CosimManipulator import CosimManipulator
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave

REAL, INTEGER = CosimVariableType.REAL, CosimVariableType.INTEGER

case = from_command_line()
log_output_level(CosimLogLevel.WARNING)
nanoseconds = round(case.step * 1e9)
execution = CosimExecution.from_step_size(nanoseconds)
slave = CosimLocalSlave(case.fmu, "crane")  # must outlive the execution
index = execution.add_local_slave(slave)
if index < 0:
    raise SystemExit(f"libcosim cannot load {case.fmu}")
variables = {
    variable.name.decode(): (variable.reference, CosimVariableType(variable.type))
    for variable in execution.slave_variables(index)
}
manipulator, observer = CosimManipulator.create_override(), CosimObserver.create_time_series()
execution.add_manipulator(manipulator)
execution.add_observer(observer)

for name, value in case.start.items():
    reference, kind = variables[name]
    setters = {
        REAL: execution.real_initial_value,
        INTEGER: execution.integer_initial_value,
        CosimVariableType.STRING: execution.string_initial_value,
    }
    if not setters[kind](index, reference, float(value) if kind is REAL else value):
        raise SystemExit(f"libcosim refuses the start value of {name}")
for name in case.outputs:
    observer.start_time_series(index, *variables[name])

changes = case.changes
for number in range(case.steps):
    for name, value in changes.get(number, {}).items():
        if not manipulator.slave_real_values(index, [variables[name][0]], [value]):
            raise SystemExit(f"libcosim refuses the input {name}")
    if not execution.step():
        raise SystemExit(f"libcosim: step {number} failed")


def samples(name: str) -> tuple[list[int], list[float]]:
    """Times, ns, and values. Read in two parts: with step 0 among them, the last one is dropped."""
    read, reference = observer.time_series_real_samples, variables[name][0]
    first_time, _, first_value = read(index, reference, 0, 2)
    times, _, values = read(index, reference, 1, case.steps)
    return [*first_time[:1], *times], [*first_value[:1], *values]


columns = [samples(name) for name in case.outputs]
time = [at / 1e9 for at in columns[0][0]]
case.write(zip(time, *(values for _, values in columns), strict=True))
