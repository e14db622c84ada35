"""crane_observer.fmu: a steady-state Kalman filter on the linear crane, as an FMI 2.0 slave."""

from typing import Any

from chaincrane.observer import CraneObserver
from chaincrane.observer_interface import VARIABLES, settings
from fmi_slave import FmiSlave, mend_import


class crane_observer(FmiSlave):
    """A steady-state Kalman filter on the linear crane."""

    variables = VARIABLES

    @staticmethod
    def make_model(parameters: dict[str, Any]) -> CraneObserver:
        """The model; raises CraneError for what is not allowed."""
        return CraneObserver(settings(parameters))


mend_import(globals())
