"""The string's first modes, computed on a fine mesh and cut off there.

A filter of few states needs the right frequencies more than it needs elements: two elements put
mode 2 a tenth too high, two modes of forty elements are right to a thousandth. What the modes left
out would give way by, at rest, is kept (the residual flexibility of structural dynamics): the top
of a chain bends in all of them.
"""

from __future__ import annotations

import numpy as np

from ..plant.chain import Array, DiscreteChain, interpolation
from ..plant.interface import MATERIAL_POINTS
from ..plant.linear import Modes, TautString

MESH = 40  # elements


class StringModes(TautString):
    """The first ``count`` modes of ``chain``: a string as the linear crane's, with fewer states."""

    def __init__(self, chain: DiscreteChain, count: int) -> None:
        super().__init__(chain)
        every, push = self.modes, self.push
        rest = slice(count, None)
        pliant = every.shapes[:, rest] / every.omega[rest] ** 2
        nodes_pulled = np.vstack((-pliant @ push[rest], pliant @ every.shapes[-1, rest])).T
        self.modes = Modes(every.omega[:count], every.shapes[:, :count])
        self.push = push[:count]
        self._response = (0.0, self.push, self.push)
        top = -float(chain.rest[0, 1])  # m, depth of the first node
        self.depth = -float(chain.rest[-1, 1])  # m, of the payload
        fractions = np.append(np.arange(1, MATERIAL_POINTS + 1) / MATERIAL_POINTS, 0.5)
        rows = interpolation(chain.elements, fractions)
        self.points: Array = rows @ self.modes.shapes  # material points, and the middle: of eta
        self.slope: Array = self.modes.shapes[0] / top  # of the chain at its top: of eta
        self.end: Array = self.modes.shapes[-1]  # the payload's displacement: of eta
        # By what the modes left out move, at rest: a column for 1 m/s2 of the trolley, one for 1 N.
        self.points_left: Array = rows @ nodes_pulled
        self.slope_left: Array = nodes_pulled[0] / top
        self.end_left: Array = nodes_pulled[-1]
        # The payload's displacement and the top's slope by 1 N on it at rest, m/N and 1/N.
        squares = self.modes.omega**2
        self.end_by_force = float(self.end @ (self.end / squares) + self.end_left[1])
        self.slope_by_force = float(self.slope @ (self.end / squares) + self.slope_left[1])
