"""A small FMI host around FMPy's FMU2Slave, for tests that make single FMI calls.

Meant for a process of its own (conftest.in_fresh_process): an FMU is a binary.
"""

from __future__ import annotations

import shutil
from ctypes import byref
from typing import Any

from fmpy import extract, read_model_description
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    FMU2Slave,
    calloc,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
    free,
)
from fmpy.logging import addLoggerProxy

OK, WARNING, DISCARD, ERROR, FATAL = range(5)
LOG: list[str] = []


def _keep(env: Any, instance: bytes, status: int, category: bytes, message: bytes) -> None:
    LOG.append(f"{category.decode()}: {message.decode()}")


CALLBACKS = fmi2CallbackFunctions()
CALLBACKS.logger = fmi2CallbackLoggerTYPE(_keep)
CALLBACKS.allocateMemory = fmi2CallbackAllocateMemoryTYPE(calloc)
CALLBACKS.freeMemory = fmi2CallbackFreeMemoryTYPE(free)
addLoggerProxy(byref(CALLBACKS))


class Host:
    """One instance of an FMU, its variables by name."""

    def __init__(self, fmu: str, initialise: bool = True, **start: Any) -> None:
        self.description = read_model_description(fmu)
        self.variables = {v.name: v for v in self.description.modelVariables}
        self.folder = extract(fmu)
        self.slave = FMU2Slave(
            guid=self.description.guid,
            unzipDirectory=self.folder,
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName="crane",
        )
        self.slave.instantiate(callbacks=CALLBACKS, loggingOn=True)
        self.time = 0.0
        if initialise:
            self.initialise(**start)

    def initialise(self, **start: Any) -> None:
        """From instantiated to the first step; names with '__' for '.'."""
        self.slave.setupExperiment(startTime=0.0)
        for name, value in start.items():
            self.set(name.replace("__", "."), value)
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()
        self.time = 0.0

    def set(self, name: str, value: Any) -> None:
        variable = self.variables[name]
        getattr(self.slave, f"set{variable.type}")([variable.valueReference], [value])

    def get(self, name: str) -> Any:
        variable = self.variables[name]
        return getattr(self.slave, f"get{variable.type}")([variable.valueReference])[0]

    def outputs(self) -> list[float]:
        """All Real outputs, in the interface's order."""
        real = [v for v in self.variables.values() if v.causality == "output" and v.type == "Real"]
        return list(self.slave.getReal([v.valueReference for v in real]))

    def step(self, h: float = 0.01, at: float | None = None) -> int:
        """One doStep; its status."""
        now = self.time if at is None else at
        try:
            self.slave.doStep(currentCommunicationPoint=now, communicationStepSize=h)
        except FMICallException as error:
            return int(error.status)
        self.time = now + h
        return OK

    def run(self, steps: int, h: float = 0.01) -> list[list[float]]:
        """Outputs after each of so many steps."""
        rows = []
        for _ in range(steps):
            assert self.step(h) == OK, LOG
            rows.append(self.outputs())
        return rows

    def close(self) -> None:
        self.slave.freeInstance()
        shutil.rmtree(self.folder, ignore_errors=True)
