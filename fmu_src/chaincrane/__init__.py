"""Models of an overhead crane with a flexible chain: nonlinear, and linear with the same interface.

Import what you need from its module: ``chaincrane.nonlinear``, ``chaincrane.kernel``,
``chaincrane.linear``, ``chaincrane.parameters``. Nothing is imported here, so that a model loads no
more than it uses.
"""
