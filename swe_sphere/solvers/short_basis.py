"""A Krylov basis by short recurrences: each vector is orthogonal to the few before it alone."""

import math

from swe_sphere.arrays import Array
from swe_sphere.solvers.vector_space import VectorSpace

WINDOW = 2
"""Vectors that a new one is made orthogonal to: all that count for a skew operator, as that of
waves is in the inner product of their energy (Gaudreault, Rainwater & Tokman 2018)."""
REMAINDER = 0.1
"""A second pass is due where the first left less than this part of a vector."""


class ShortBasis:
    """Room for `size` vectors; `rows[k]` is the k-th, in the memory of `stack` (size, n)."""

    def __init__(self, space: VectorSpace, size: int) -> None:
        self.space = space
        self.stack = space.room(size)
        self.rows = [self.stack[k] for k in range(size)]
        self._windows = [self.stack[max(0, k - WINDOW) : k + 1] for k in range(size)]

    def start(self, length: float) -> None:
        """Begin anew with rows[0], whose length is given."""
        self.space.scale(1.0 / length, self.rows[0])

    def extend(self, count: int) -> tuple[Array, float]:
        """Make v = rows[count] of length 1 and orthogonal to the WINDOW rows before it.

        Returns (c, r) with v at entry = sum_s c_s w_s + r v at exit, w the last len(c) rows before
        it.  r is 0 when nothing but round-off is left of v, and not finite when v is not.
        """
        window, row = self._windows[count], self.rows[count]
        c, square = self._project(count)
        rest = square - float(c.dot(c))
        if rest < REMAINDER**2 * square:
            self.space.combine(row, window, -c, row)
            more, left = self._project(count)
            c, rest = c + more, left - float(more.dot(more))
            if rest <= (10.0 * self.space.epsilon) ** 2 * square:
                return c, 0.0
            self.space.combine(row, window, -more, row, 1.0 / math.sqrt(rest))
            return c, math.sqrt(rest)
        if not 0.0 < rest < math.inf:
            return c, 0.0 if square == 0.0 else math.nan
        self.space.combine(row, window, -c, row, 1.0 / math.sqrt(rest))
        return c, math.sqrt(rest)

    def _project(self, count: int) -> tuple[Array, float]:
        """<w_s, v> for the rows of the window, and <v, v>."""
        before = min(count, WINDOW)
        products = self.space.project(self._windows[count], before + 1, self.rows[count])
        return products[:before].copy(), float(products[before])
