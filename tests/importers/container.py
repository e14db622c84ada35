"""Wrap an FMU in a container FMU (fmu-manipulation-toolbox), and simulate that with FMPy."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from fmpy import read_model_description, simulate_fmu
from fmu_manipulation_toolbox.container import FMUContainer
from importers.case import from_command_line

case = from_command_line()
fmu = Path(case.fmu)
names = list(dict.fromkeys(name for _, values in case.input for name in values))
held = dict.fromkeys(names, 0.0)
rows: list[tuple[float, ...]] = []
for time, values in case.input:  # FMPy's convention: a repeated time row is a jump
    if time > 0.0:
        rows.append((time, *held.values()))
    held |= values
    rows.append((time, *held.values()))

with tempfile.TemporaryDirectory() as folder:
    container = FMUContainer("container", fmu.parent)
    container.get_fmu(fmu.name)
    for variable in read_model_description(str(fmu)).modelVariables:
        if variable.causality in ("input", "parameter"):
            container.add_input(variable.name, fmu.name, variable.name)
        elif variable.causality == "output":
            container.add_output(fmu.name, variable.name, variable.name)
    wrapped = Path(folder, "container.fmu")
    container.make_fmu(wrapped, case.step)
    result = simulate_fmu(
        str(wrapped),
        start_time=0.0,
        stop_time=case.stop,
        output_interval=case.step,
        start_values=case.start,
        input=np.array(rows, dtype=[("time", float)] + [(name, float) for name in names]),
        output=case.outputs,
        fmi_type="CoSimulation",
    )
case.write([row[name] for name in ["time", *case.outputs]] for row in result)
