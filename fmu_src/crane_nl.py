"""crane_nl.fmu: the nonlinear crane, a chain of truss elements, as an FMI 2.0 slave."""

from typing import Any

from chaincrane.interface import VARIABLES, settings
from chaincrane.nonlinear import NonlinearCrane
from fmi_slave import FmiSlave, mend_import


class crane_nl(FmiSlave):
    """Overhead crane with a flexible chain, nonlinear (Maourane & Szabo 2020, section 2.1)."""

    variables = VARIABLES

    @staticmethod
    def make_model(parameters: dict[str, Any]) -> NonlinearCrane:
        """The nonlinear crane; raises CraneError for what is not allowed."""
        return NonlinearCrane(*settings(parameters))


mend_import(globals())
