"""crane_antisway.fmu: trolley.a_cmd from a target and an estimate, as an FMI 2.0 slave."""

from typing import Any

from chaincrane.antisway import AntiSway
from chaincrane.antisway_interface import VARIABLES, settings
from fmi_slave import FmiSlave, mend_import


class crane_antisway(FmiSlave):
    """A command for the trolley from a target and an estimate."""

    variables = VARIABLES

    @staticmethod
    def make_model(parameters: dict[str, Any]) -> AntiSway:
        """The model; raises CraneError for what is not allowed."""
        return AntiSway(settings(parameters))


mend_import(globals())
