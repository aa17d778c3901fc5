"""The small least-squares problem of GMRES, factored column by column with Givens rotations."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["HessenbergLeastSquares"]

# Columns that lower the residual by less than this part are not used.
GAIN = 1e-6


class HessenbergLeastSquares:
    """min_y |beta e_1 - H y| for an upper Hessenberg H (k + 1, k) that grows by a column at a time.

    Saad, Iterative Methods for Sparse Linear Systems (2003), section 6.5.3.  Plain floats: at the
    sizes of a Krylov basis they are faster than numpy.  A diagonal of the triangle that cancelled
    to round-off (epsilon) counts as zero, and its component of y as open.
    """

    def __init__(self, beta: float, epsilon: float) -> None:
        self._epsilon = epsilon
        self._columns: list[list[float]] = []
        self._rotations: list[tuple[float, float]] = []
        self._rhs = [beta]
        self._residuals = [beta]

    def append(self, column: Sequence[float], below: float) -> float:
        """Add the column H[:k, k-1], H[k, k-1] = below; returns the least |beta e_1 - H y|."""
        c = list(column)
        for i, (cosine, sine) in enumerate(self._rotations):
            c[i], c[i + 1] = cosine * c[i] + sine * c[i + 1], cosine * c[i + 1] - sine * c[i]
        diagonal = math.hypot(c[-1], below)
        # at a breakdown (below = 0) what an ill-conditioned H leaves there is its noise
        smallest = self._epsilon ** (1.0 / 3.0) if below == 0.0 else 8.0 * self._epsilon
        if diagonal > smallest * math.hypot(*column, below):
            cosine, sine, c[-1] = c[-1] / diagonal, below / diagonal, diagonal
        else:
            cosine, sine, c[-1] = 0.0, 1.0, 0.0
        self._columns.append(c)
        self._rotations.append((cosine, sine))
        last = self._rhs[-1]
        self._rhs[-1:] = [cosine * last, -sine * last]
        self._residuals.append(abs(self._rhs[-1]))
        return self._residuals[-1]

    def solve(self) -> NDArray[np.float64]:
        """The minimising y, without the last columns if these gain nothing.

        Where they gain nothing, as for a singular operator, they would bring large components.
        """
        enough = (1.0 + GAIN) * self._residuals[-1]
        count = next(k for k, residual in enumerate(self._residuals) if residual <= enough)
        y = self._rhs[:count]
        for k in range(count - 1, -1, -1):
            column = self._columns[k]
            y[k] = y[k] / column[k] if column[k] > 0.0 else 0.0
            for i in range(k):
                y[i] -= column[i] * y[k]
        return np.array(y)
