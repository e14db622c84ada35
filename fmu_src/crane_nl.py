"""crane_nl.fmu: the nonlinear crane, a chain of truss elements, as an FMI 2.0 slave.

The C kernel steps it where one fits the host, and NumPy is not even imported; elsewhere the NumPy
model does, and the log says so.
"""

from typing import Any

from pythonfmu.enums import Fmi2Status

from chaincrane.plant import kernel
from chaincrane.plant.command import Command
from chaincrane.plant.interface import VARIABLES, settings
from chaincrane.requirements import require
from chaincrane.wrapper import mend
from fmi_slave import FmiSlave, Model

try:  # now, and once in a process: the folder of an FMU that is loaded later may be gone
    LIBRARY, MISSING = kernel.load_library(), ""
except kernel.KernelMissing as error:
    LIBRARY, MISSING = None, str(error)
    require("numpy", "scipy")
    from chaincrane.plant.tolerance import nonlinear_crane


class crane_nl(FmiSlave):
    """Overhead crane with a flexible chain, nonlinear (Maourane & Szabo 2020, section 2.1)."""

    variables = VARIABLES
    inputs = Command
    step_unit = "solver.max_step"
    _warned = False

    def make_model(self, parameters: dict[str, Any]) -> Model:
        """The nonlinear crane; raises CraneError for what is not allowed."""
        chosen = settings(parameters, self.tolerance)
        if LIBRARY is not None:
            return kernel.NativeCrane(*chosen, library=LIBRARY)
        if not self._warned:
            warning = f"{MISSING}: the NumPy model runs instead, some two hundred times slower"
            self.log(warning, Fmi2Status.warning, "logStatusWarning")
            self._warned = True
        return nonlinear_crane(*chosen)


mend(globals())
