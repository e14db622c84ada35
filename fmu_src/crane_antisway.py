"""crane_antisway.fmu: trolley.a_cmd from a target and an estimate, as an FMI 2.0 slave."""

from typing import Any

from chaincrane.requirements import require
from fmi_slave import FmiSlave, Model, mend_import

require("numpy", "scipy")
from chaincrane.control.antisway import AntiSway, AntiSwayInput  # noqa: E402
from chaincrane.control.antisway_interface import VARIABLES, settings  # noqa: E402


class crane_antisway(FmiSlave):
    """A command for the trolley from a target and an estimate."""

    variables = VARIABLES
    inputs = AntiSwayInput

    def make_model(self, parameters: dict[str, Any]) -> Model:
        """The controller; raises CraneError for what is not allowed."""
        return AntiSway(settings(parameters))


mend_import(globals())
