"""Orthonormal bases that grow by one vector at a time: the Gram-Schmidt part of Arnoldi."""

import math

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.solvers.vector_space import VectorSpace

# A second pass is due at the latest when the first left less than this part of a vector.
REMAINDER = 0.1
WINDOW = 2
"""Vectors that a new one is made orthogonal to in a short basis: all that count for a skew
operator, as that of waves is in the inner product of their energy (Gaudreault, Rainwater & Tokman
2018)."""


class KrylovBasis:
    """Room for `size` vectors; `rows[k]` is the k-th, in the memory of `stack` (size, n).

    A vector is made orthogonal to all vectors before it, or to the last WINDOW in a short basis.
    """

    def __init__(self, space: VectorSpace, size: int, short: bool = False) -> None:
        self.space, self._short = space, short
        self.stack = space.room(size)
        self.rows = [self.stack[k] for k in range(size)]
        self._firsts = [max(0, k - WINDOW) if short else 0 for k in range(size)]
        self._stacks = [self.stack[first:] if first else self.stack for first in self._firsts]
        # bound of |I - V' V|, and how far it may grow: semi-orthogonality is as good as the full
        # one for what is read off the projections (Simon 1984, doi:10.1016/0024-3795(84)90025-9)
        self._loss = 0.0
        self._allowed = math.sqrt(space.epsilon)

    def start(self, length: float) -> None:
        """Begin again with rows[0], whose length is given."""
        self.space.scale(1.0 / length, self.rows[0])
        self._loss = self.space.epsilon

    def extend(self, count: int) -> tuple[Array, float]:
        """Make v = rows[count] orthonormal to the k rows before it that it is made orthogonal to.

        Returns (c (k,), r) with v at entry = sum_s c_s rows[s] + r v at exit.  r is 0, and v at
        exit without meaning, when v lies in the span of the rows to round-off; r is not finite when
        v is not.  Classical Gram-Schmidt, with a second pass where cancellation calls for one and
        then no more ("twice is enough": Parlett, The Symmetric Eigenvalue Problem, section 6.9;
        Giraud, Langou, Rozloznik & van den Eshof 2005, doi:10.1007/s00211-005-0615-4).
        """
        c, square = self._project(count)
        length = self._subtract_once(count, c, square)
        if length is not None:
            return c, length
        if not 0.0 < square < math.inf:
            return c, 0.0 if square == 0.0 else math.nan
        row = self.rows[count]
        self.space.combine(row, self._stacks[count], -c, row)
        more, left = self._project(count)
        rest = left - float(more.dot(more))
        if rest <= max(REMAINDER**2 * left, (10.0 * self.space.epsilon) ** 2 * square):
            return c + more, 0.0
        return c + more, self._subtract(count, more, rest)

    def extend_block(self, count: int, block: int) -> list[tuple[Array, float]]:
        """Make the rows from `count` on, `block` of them, orthonormal, by one reduction.

        Returns the results of `extend`, fewer where r comes out as 0 or not finite.  What `extend`
        takes from two passes, it gets vector by vector where the products show that cancellation
        calls for it.  Gram-Schmidt by blocks with a Cholesky factorisation inside: Hoemmen 2010,
        Communication-avoiding Krylov subspace methods, section 2.4.
        """
        calls = [(self.stack, count + j + 1, self.rows[count + j]) for j in range(block)]
        products = self.space.projections(*calls).copy()
        ends = np.cumsum([size for _, size, _ in calls])
        found: list[tuple[Array, float]] = []
        for j, column in enumerate(np.split(products, ends[:-1])):
            for i, (above, length) in enumerate(found):
                shared = column[: count + i].dot(above)
                column[count + i] = (column[count + i] - shared) / length
            done = self._subtract_once(count + j, column[:-1], float(column[-1]))
            if done is None:
                break
            found.append((column[:-1], done))
        for j in range(len(found), block):
            found.append(self.extend(count + j))
            if not 0.0 < found[-1][1] < math.inf:
                break
        return found

    def _project(self, count: int) -> tuple[Array, float]:
        """Products of a row with the rows before it, and with itself."""
        size = count - self._firsts[count] + 1
        products = self.space.project(self._stacks[count], size, self.rows[count])
        return products[:-1].copy(), float(products[-1])

    def _subtract_once(self, count: int, c: Array, square: float) -> float | None:
        """Subtract in one pass, see `_subtract`; None where cancellation calls for two passes.

        What orthogonality was lost before is amplified: the new row is off the others by
        |E c| / r + round-off |v| / r, and off length one, because of Pythagoras, by c' E c / r^2.
        """
        taken = float(c.dot(c))
        rest = square - taken
        if not rest >= REMAINDER**2 * square > 0.0:
            return None
        if not self._short:
            ratio = math.sqrt(taken / rest)
            growth = self._loss * ratio * max(ratio, 1.0)
            loss = self._loss + growth + self.space.epsilon * math.sqrt(square / rest)
            if not loss <= self._allowed:
                return None
            self._loss = loss
        return self._subtract(count, c, rest)

    def _subtract(self, count: int, c: Array, rest: float) -> float:
        """Take the components off the vector and normalise it; returns its length before that.

        The length comes from Pythagoras, which there is accurate: the vector is read once less.
        """
        length, row = math.sqrt(rest), self.rows[count]
        self.space.combine(row, self._stacks[count], -c, row, 1.0 / length)
        return length
