"""The small least-squares problem of GMRES, factored column by column with Givens rotations."""

import math
from collections.abc import Sequence

import numpy as np

from swe_sphere.arrays import Array

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
        self._sizes: list[float] = []

    def append(self, column: Sequence[float], below: float) -> float:
        """Add the column H[:k, k-1], H[k, k-1] = below; returns the least |beta e_1 - H y|."""
        c = list(column)
        for i, (cosine, sine) in enumerate(self._rotations):
            c[i], c[i + 1] = cosine * c[i] + sine * c[i + 1], cosine * c[i + 1] - sine * c[i]
        diagonal = math.hypot(c[-1], below)
        # at a breakdown (below = 0) what an ill-conditioned H leaves there is its noise
        smallest = self._epsilon ** (1.0 / 3.0) if below == 0.0 else 8.0 * self._epsilon
        self._sizes.append(math.hypot(*column, below))
        if diagonal > smallest * self._sizes[-1]:
            cosine, sine, c[-1] = c[-1] / diagonal, below / diagonal, diagonal
        else:
            cosine, sine, c[-1] = 0.0, 1.0, 0.0
        self._columns.append(c)
        self._rotations.append((cosine, sine))
        last = self._rhs[-1]
        self._rhs[-1:] = [cosine * last, -sine * last]
        self._residuals.append(abs(self._rhs[-1]))
        return self._residuals[-1]

    def solve(self) -> tuple[Array, float, float]:
        """The minimising y, the residual it leaves, and the size of the terms that cancel in H y.

        y is shorter than H is wide where the last columns gain nothing, or less than they cost by
        round-off in those terms, sum_k |y_k| |H e_k|: so it is when the operator is singular.
        """
        residuals = self._residuals
        enough = (1.0 + GAIN) * residuals[-1]
        count = next(k for k, residual in enumerate(residuals) if residual <= enough)
        y, terms = self._solve(count)
        if self._epsilon * terms > residuals[count]:
            found = [self._solve(k) for k in range(count + 1)]
            sums = [r + self._epsilon * f[1] for r, f in zip(residuals, found, strict=False)]
            count = sums.index(min(sums))
            y, terms = found[count]
        return np.array(y), residuals[count], terms

    def _solve(self, count: int) -> tuple[list[float], float]:
        """The y of the first columns alone, by back substitution, and the size of the terms."""
        y = self._rhs[:count]
        for k in range(count - 1, -1, -1):
            column = self._columns[k]
            y[k] = y[k] / column[k] if column[k] > 0.0 else 0.0
            for i in range(k):
                y[i] -= column[i] * y[k]
        return y, math.fsum(abs(a * b) for a, b in zip(y, self._sizes, strict=False))
