"""Other masters for a loop's SSP package: ecos and libcosim, which step all parts in parallel.

Neither goes beyond what the package says: parts, connections, start values, step.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from .errors import UserError
from .instances import Instances
from .loop import SEPARATOR, Loop
from .progress import Progress
from .ssp import PARAMETERS
from .tables import Table

MASTERS = ("fmpy", "ecos", "libcosim")
INSTALL = "pip install -e '.[importers]'"


@dataclass(frozen=True)
class Package:
    """A loop's SSP package, run by another master."""

    master: str  # ecos or libcosim
    ssp: Path
    loop: Loop
    alone = True  # another tool's binaries

    @property
    def name(self) -> str:
        """What messages call it."""
        return f"{self.ssp}, {self.master}"

    @property
    def stop_time(self) -> float:
        """Simulated time, s."""
        return self.loop.stop_time

    def run(self, _instances: Instances, progress: Progress | None = None) -> Table:
        """Run in this process, which loads no other FMU. Raises UserError."""
        run = {"ecos": _run_ecos, "libcosim": _run_libcosim}[self.master]
        return run(self.ssp, self.loop, progress or (lambda time: None))


def _require(module: str, what: str) -> Any:
    try:
        return import_module(module)
    except (ImportError, OSError) as error:
        hint = "Debian: libtbb12" if "libtbb" in str(error) else INSTALL
        raise UserError(f"{what} cannot be loaded: {error} ({hint})") from error


def _run_ecos(ssp: Path, loop: Loop, progress: Progress) -> Table:
    """ecos hands outputs over after all parts have stepped; its columns are named as ours."""
    ecospy = _require("ecospy", "ecos")
    ecospy.EcosLib.set_log_level("warn")
    result = loop.table()
    assert result.dtype.names is not None
    _, *names = result.dtype.names
    with ecospy.EcosSimulation(loop.step, ssp_path=str(ssp)) as simulation:
        if not simulation.init(0.0, PARAMETERS):
            raise UserError(f"{ssp}: ecos: {ecospy.EcosLib.get_last_error()}")
        for number in range(loop.steps + 1):
            if number:
                simulation.step()
            values = [simulation.get_real(name) for name in names]
            result[number] = (simulation.get_time(), *values)
            progress(number * loop.step)
        simulation.terminate()
    return result


def _run_libcosim(ssp: Path, loop: Loop, progress: Progress) -> Table:
    """libcosim keeps a time series of each watched variable."""
    execution_type = _require("libcosimpy.CosimExecution", "libcosim").CosimExecution
    logging = _require("libcosimpy.CosimLogging", "libcosim")
    observer_type = _require("libcosimpy.CosimObserver", "libcosim").CosimObserver
    kind = _require("libcosimpy.CosimEnums", "libcosim").CosimVariableType.REAL
    logging.log_output_level(logging.CosimLogLevel.WARNING)
    try:
        execution = execution_type.from_ssp_file(str(ssp), round(loop.step * 1e9))
    except AssertionError as error:
        raise UserError(f"{ssp}: libcosim: {error}") from error
    observer = observer_type.create_time_series()
    execution.add_observer(observer)
    result = loop.table()
    assert result.dtype.names is not None
    _, *names = result.dtype.names
    places = {}
    for name in names:
        part, variable = name.split(SEPARATOR)
        index = execution.slave_index_from_instance_name(part)
        references = {v.name.decode(): v.reference for v in execution.slave_variables(index)}
        places[name] = index, references[variable]
        observer.start_time_series(*places[name], kind)
    for number in range(loop.steps):
        if not execution.step():
            raise UserError(f"{ssp}: libcosim: step {number} failed")
        progress(number * loop.step)
    for name, place in places.items():
        # Read in two parts: with step 0 among them, libcosimpy drops the last sample.
        first_time, _, first = observer.time_series_real_samples(*place, 0, 2)
        times, _, values = observer.time_series_real_samples(*place, 1, loop.steps)
        result[name] = [*first[:1], *values]
        result["time"] = [at / 1e9 for at in (*first_time[:1], *times)]
    return result
