"""crane_lin.fmu: the linear crane, a taut string stepped exactly, as an FMI 2.0 slave."""

from chaincrane.linear import LinearCrane
from crane_slave import CraneSlave, mend_import


class crane_lin(CraneSlave):
    """Overhead crane with a flexible chain, linear (Maourane & Szabo 2020, section 2.2)."""

    model_class = LinearCrane


mend_import(globals())
