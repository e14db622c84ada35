"""An overhead crane with a flexible chain: the cranes (``plant``), a loop over them (``control``).

Import what you need from its module, as ``chaincrane.plant.nonlinear``. Nothing is imported here,
so that a model loads no more than it uses.
"""
