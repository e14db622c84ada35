"""crane_antisway.fmu: trolley.a_cmd from a target and an estimate, as an FMI 2.0 slave."""

from typing import Any

from chaincrane.requirements import require
from chaincrane.wrapper import mend
from fmi_slave import FmiSlave, Model

require("numpy", "scipy")
from chaincrane.control import stability  # noqa: E402
from chaincrane.control.antisway import FEEDBACK, AntiSway, AntiSwayInput  # noqa: E402
from chaincrane.control.antisway_interface import VARIABLES, settings  # noqa: E402

USUAL_STEP = 0.01  # s, what is told at initialisation is told for


class crane_antisway(FmiSlave):
    """A command for the trolley from a target and an estimate."""

    variables = VARIABLES
    inputs = AntiSwayInput

    def make_model(self, parameters: dict[str, Any]) -> Model:
        """The controller; raises CraneError for what is not allowed."""
        control = AntiSway(settings(parameters))
        if control.settings.method in FEEDBACK:
            control.warning = stability.warning(control, USUAL_STEP)
        return control


mend(globals())
