"""crane_lin.fmu: the linear crane, a taut string stepped exactly, as an FMI 2.0 slave."""

from typing import Any

from chaincrane.interface import VARIABLES, settings
from chaincrane.linear import LinearCrane
from fmi_slave import FmiSlave, mend_import


class crane_lin(FmiSlave):
    """Overhead crane with a flexible chain, linear (Maourane & Szabo 2020, section 2.2)."""

    variables = VARIABLES

    @staticmethod
    def make_model(parameters: dict[str, Any]) -> LinearCrane:
        """The linear crane; raises CraneError for what is not allowed."""
        return LinearCrane(*settings(parameters))


mend_import(globals())
