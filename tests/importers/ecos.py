"""Simulate an FMU with ecos (ecospy)."""

from __future__ import annotations

import zipfile
from xml.etree import ElementTree

from ecospy import EcosLib, EcosSimulation, EcosSimulationStructure
from importers.case import from_command_line

MODEL, PARAMETERS = "crane", "start"

case = from_command_line()
EcosLib.set_log_level("warn")
with zipfile.ZipFile(case.fmu) as archive:
    root = ElementTree.fromstring(archive.read("modelDescription.xml"))
types = {variable.attrib["name"]: variable[0].tag for variable in root.iter("ScalarVariable")}
start = {  # ecos goes by the Python type, and ignores what does not fit
    f"{MODEL}::{name}": float(value) if types[name] == "Real" else value
    for name, value in case.start.items()
}
with EcosSimulationStructure() as structure:
    structure.add_model(MODEL, case.fmu)
    structure.add_parameter_set(PARAMETERS, start)
    with EcosSimulation(case.step, structure=structure) as simulation:
        if not simulation.init(0.0, PARAMETERS):
            raise SystemExit(f"ecos: {EcosLib.get_last_error()}")

        def row() -> list[float]:
            """Time and outputs now."""
            values = [simulation.get_real(f"{MODEL}::{name}") for name in case.outputs]
            return [simulation.get_time(), *values]

        rows = [row()]
        changes = case.changes
        for number in range(case.steps):
            for name, value in changes.get(number, {}).items():
                simulation.set_real(f"{MODEL}::{name}", value)
            simulation.step()
            rows.append(row())
        simulation.terminate()
case.write(rows)
