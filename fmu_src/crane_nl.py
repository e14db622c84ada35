"""crane_nl.fmu: the nonlinear crane, a chain of truss elements, as an FMI 2.0 slave."""

from chaincrane.nonlinear import NonlinearCrane
from crane_slave import CraneSlave, mend_import


class crane_nl(CraneSlave):
    """Overhead crane with a flexible chain, nonlinear (Maourane & Szabo 2020, section 2.1)."""

    model_class = NonlinearCrane


mend_import(globals())
