"""crane_observer.fmu: a steady-state Kalman filter on the linear crane, as an FMI 2.0 slave."""

from typing import Any

from chaincrane.requirements import require
from chaincrane.wrapper import mend
from fmi_slave import FmiSlave, Model

require("numpy", "scipy")
from chaincrane.control.observer import CraneObserver, ObserverInput  # noqa: E402
from chaincrane.control.observer_interface import VARIABLES, settings  # noqa: E402


class crane_observer(FmiSlave):
    """A steady-state Kalman filter on the linear crane."""

    variables = VARIABLES
    inputs = ObserverInput

    def make_model(self, parameters: dict[str, Any]) -> Model:
        """The observer; raises CraneError for what is not allowed."""
        return CraneObserver(settings(parameters))


mend(globals())
