"""Block-tridiagonal systems of 2x2 blocks, stored as LAPACK bands and solved in O(n)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgbsv, dgbtrf, dgbtrs, dptsv

from .chain import DiscreteChain

Array = NDArray[np.float64]

_BAND = 3  # sub- and superdiagonals of a matrix that couples (x, y) of neighbouring nodes
_ROWS = 3 * _BAND + 1  # LAPACK's storage, with room for the fill of its pivoting


def mass_bands(chain: DiscreteChain) -> Array:
    """The free nodes' mass matrix as bands, shape (n, 2, 10): node, component, band row."""
    bands = np.zeros((chain.elements, 2, _ROWS))
    for c in range(2):
        bands[:, c, 2 * _BAND] = chain.mass_diagonal
        bands[:-1, c, 2 * _BAND + 2] = chain.mass_coupling
        bands[1:, c, 2 * _BAND - 2] = chain.mass_coupling
    return bands


def add_tangents(bands: Array, tangent: Array) -> Array:
    """``bands`` plus the assembly of the elements' tangents (n, 2, 2), as new bands.

    The entry (row, column) of a matrix stands at band row 2*3 + row - column of its column. Node e
    gets T_e + T_(e+1) on the diagonal block, and -T_e couples it with node e-1.
    """
    total = bands.copy()
    diagonal = tangent.copy()
    diagonal[:-1] += tangent[1:]
    for r in range(2):
        for c in range(2):
            row = 2 * _BAND + r - c
            total[:, c, row] += diagonal[:, r, c]
            total[:-1, c, row + 2] -= tangent[1:, r, c]
            total[1:, c, row - 2] -= tangent[1:, r, c]
    return total


def _columns(bands: Array) -> Array:
    return bands.reshape(-1, _ROWS).T


def solve(bands: Array, load: Array) -> Array | None:
    """Solve for nodal values (n, 2); None where the matrix is singular. Uses up ``bands``."""
    _, _, x, info = dgbsv(_BAND, _BAND, _columns(bands), load.ravel(), overwrite_ab=True)
    return x.reshape(load.shape) if info == 0 else None


def solve_tridiagonal(diagonal: Array, coupling: Array, load: Array) -> Array:
    """Solve for nodal values (n, 2) with one symmetric positive definite matrix for x and y.

    ``diagonal`` (n,) and ``coupling`` (n - 1,) are its entries, the same for both components.
    """
    x: Array
    if len(diagonal) == 1:  # LAPACK's wrapper refuses an empty coupling
        x = load / diagonal[0]
        return x
    _, _, x, _ = dptsv(diagonal, coupling, load)
    return x


class Factors:
    """LU factors of a matrix that is solved with more than once. Uses up ``bands``."""

    def __init__(self, bands: Array) -> None:
        self._lu, self._pivots, self.singular = dgbtrf(
            _columns(bands), _BAND, _BAND, overwrite_ab=True
        )

    def solve(self, load: Array) -> Array:
        """Solve for nodal values, shape (n, 2)."""
        x, _ = dgbtrs(self._lu, _BAND, _BAND, load.ravel(), self._pivots)
        return np.asarray(x).reshape(load.shape)
