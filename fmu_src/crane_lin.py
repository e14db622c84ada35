"""crane_lin.fmu: the linear crane, a taut string stepped exactly, as an FMI 2.0 slave."""

from typing import Any

from chaincrane.plant.command import Command
from chaincrane.plant.interface import VARIABLES, settings
from chaincrane.requirements import require
from chaincrane.wrapper import mend
from fmi_slave import FmiSlave, Model

require("numpy")
from chaincrane.plant.linear import LinearCrane  # noqa: E402


class crane_lin(FmiSlave):
    """Overhead crane with a flexible chain, linear (Maourane & Szabo 2020, section 2.2)."""

    variables = VARIABLES
    inputs = Command
    step_unit = "solver.max_step"

    def make_model(self, parameters: dict[str, Any]) -> Model:
        """The linear crane; raises CraneError for what is not allowed."""
        return LinearCrane(*settings(parameters, self.tolerance))


mend(globals())
