"""FMUs that a process keeps loaded: extracted and instantiated once, reset between runs.

FMPy loads them and describes them. To load an FMU costs a hundred times what a reset does, and
pythonfmu's wrapper leaks some kilobytes at each instantiation.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterable, Mapping
from ctypes import byref
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from weakref import finalize

from fmpy import extract, platform, read_model_description
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    FMU2Slave,
    calloc,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
    fmi2Discard,
    fmi2Fatal,
    free,
)
from fmpy.logging import addLoggerProxy
from fmpy.model_description import ModelDescription, ScalarVariable
from fmpy.simulation import (
    apply_start_values,
    settable_in_initialization_mode,
    settable_in_instantiated,
)

from .errors import UserError, one_line
from .start_values import check_start_values

MOST = 16  # instances that are kept; the one that was used longest ago goes first

# A file's path, when it was written (ns) and its size: another build of an FMU is another FMU.
Stamp = tuple[str, int, int]


def describe(fmu: Path) -> ModelDescription:
    """The FMU's model description, validated by FMPy. Raises UserError."""
    if not fmu.exists():
        native = " --native" if fmu.stem.endswith("_native") else ""
        raise UserError(f"{fmu}: no such FMU; build it with: chaincrane build{native}")
    try:
        return read_model_description(str(fmu))
    except (AttributeError, TypeError) as error:  # FMPy stumbles where something is missing
        raise UserError(f"{fmu}: not a valid FMU: its XML is no model description") from error
    except Exception as error:
        raise UserError(f"{fmu}: not a valid FMU: {one_line(error)}") from error


class Log:
    """What the FMUs of a process say."""

    def __init__(self) -> None:
        self.said: list[tuple[str, int, str]] = []  # instance, status, message
        self.callbacks = fmi2CallbackFunctions()
        self.callbacks.logger = fmi2CallbackLoggerTYPE(self._keep)
        self.callbacks.allocateMemory = fmi2CallbackAllocateMemoryTYPE(calloc)
        self.callbacks.freeMemory = fmi2CallbackFreeMemoryTYPE(free)
        addLoggerProxy(byref(self.callbacks))

    def _keep(self, _env: Any, name: bytes, status: int, _kind: bytes, message: bytes) -> None:
        text = (name or b"").decode(errors="replace"), status, message.decode(errors="replace")
        self.said.append(text)

    def reason(self, otherwise: tuple[str, str]) -> tuple[str, str]:
        """Who said the first error, and what; else the last word of all, else ``otherwise``."""
        errors = [one for one in self.said if one[1] >= fmi2Discard]
        for name, _, message in errors[:1] or self.said[-1:]:
            return name, one_line(message)
        return otherwise


@cache
def process_log() -> Log:
    """The log of this process: one for all, as FMPy's proxy knows the last logger alone."""
    return Log()


def _is_run(member: str) -> bool:
    """Is a file of an FMU for those who run it here? Small files take time to unpack and remove."""
    room, _, rest = member.partition("/")
    if room == "binaries":
        return rest.startswith(f"{platform}/")
    return room not in ("documentation", "sources")


@dataclass
class Instance:
    """An FMU that is loaded: FMPy's slave, its variables by name, where it was extracted."""

    fmu: Path
    name: str
    description: ModelDescription
    variables: Mapping[str, ScalarVariable]
    folder: str
    slave: FMU2Slave
    fresh: bool = True  # it has not run yet
    broken: bool = False  # it must not run again

    def begin(self, start: Mapping[str, Any], stop_time: float) -> None:
        """A new run from 0 s: reset, then start values; initialisation begins. As FMPy does it.

        Raises UserError for a value that the FMU has no place for, FMICallException.
        """
        check_start_values(self.fmu, self.description, start)
        if not self.fresh:
            self.slave.reset()
        self.fresh = False
        experiment = self.description.defaultExperiment
        tolerance = None if experiment is None else experiment.tolerance
        self.slave.setupExperiment(
            tolerance=None if tolerance is None else float(tolerance),
            startTime=0.0,
            stopTime=stop_time,
        )
        settable = settable_in_instantiated, settable_in_initialization_mode
        values = apply_start_values(self.slave, self.description, dict(start), settable[0])
        self.slave.enterInitializationMode()
        values = apply_start_values(self.slave, self.description, values, settable[1])
        if values:
            raise UserError(f"{self.fmu}: {next(iter(values))} cannot be set")

    def end_initialisation(self) -> None:
        """From here on the FMU can step. Raises FMICallException."""
        self.slave.exitInitializationMode()

    def references(self, names: Iterable[str], kind: str) -> list[int]:
        """Value references of the variables among ``names`` that are of a kind, Real say."""
        return [
            self.variables[name].valueReference
            for name in names
            if self.variables[name].type == kind
        ]

    def free(self) -> None:
        """Free the instance, unless it is broken; its library stays, as unloading may crash."""
        if not self.broken:
            self.slave.fmi2FreeInstance(self.slave.component)
        shutil.rmtree(self.folder, ignore_errors=True)


class Instances:
    """The FMUs that a process has loaded, by file and instance name."""

    def __init__(self) -> None:
        self.log = process_log()
        self._kept: dict[tuple[Stamp, str], Instance] = {}

    def get(self, fmu: Path, name: str = "fmu") -> Instance:
        """The FMU's instance of a name, loaded if it is not yet; raises UserError.

        Two instances of one FMU in a run need two names. What one run leaves is reset by
        :meth:`Instance.begin` of the next.
        """
        try:
            file = fmu.stat()
        except OSError:
            describe(fmu)  # says that it is not there
            raise
        key = (str(fmu), file.st_mtime_ns, file.st_size), name
        instance = self._kept.pop(key, None)
        if instance is None or instance.broken:
            if instance is not None:
                instance.free()
            instance = self._load(fmu, name)
        self._kept[key] = instance  # the last is the one used last
        while len(self._kept) > MOST:
            self._kept.pop(next(iter(self._kept))).free()
        return instance

    def _load(self, fmu: Path, name: str) -> Instance:
        description = describe(fmu)
        if description.coSimulation is None or description.fmiVersion != "2.0":
            raise UserError(f"{fmu}: is not an FMI 2.0 co-simulation FMU")
        self.log.said.clear()
        try:
            folder = extract(str(fmu), include=_is_run)
        except OSError as error:
            where = f"cannot be unpacked into {tempfile.gettempdir()}"
            raise UserError(f"{fmu}: {where}: {error.strerror or error}") from error
        try:
            slave = FMU2Slave(
                guid=description.guid,
                unzipDirectory=folder,
                modelIdentifier=description.coSimulation.modelIdentifier,
                instanceName=name,
            )
            slave.instantiate(callbacks=self.log.callbacks, loggingOn=True)
        except Exception as error:
            shutil.rmtree(folder, ignore_errors=True)
            raise UserError(f"{fmu}: {self.log.reason((name, one_line(error)))[1]}") from error
        variables = {variable.name: variable for variable in description.modelVariables}
        instance = Instance(fmu, name, description, variables, folder, slave)
        finalize(instance, shutil.rmtree, folder, ignore_errors=True)  # at the latest when all ends
        return instance

    def failed(self, instance: Instance, error: FMICallException) -> tuple[str, str]:
        """Which instance is to blame for a failed call, and why, in the FMU's words.

        One that is beyond a reset will not be used again.
        """
        instance.broken = error.status >= fmi2Fatal
        return self.log.reason((instance.name, one_line(error)))
