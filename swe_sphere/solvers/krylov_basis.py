"""Bases that grow by one vector at a time: the Gram-Schmidt part of Arnoldi, whole or in short."""

import math

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.solvers.vector_space import VectorSpace

# A second pass is due at the latest when the first left less than this part of a vector.
REMAINDER = 0.1


class OrthonormalBasis:
    """Room for `size` vectors; `rows[k]` is the k-th, in the memory of `stack` (size, n)."""

    def __init__(self, space: VectorSpace, size: int) -> None:
        self.space = space
        self.stack = space.room(size)
        self.rows = [self.stack[k] for k in range(size)]
        # bound of |I - V' V|, and how far it may grow: semi-orthogonality is as good as the full
        # one for what is read off the projections (Simon 1984, doi:10.1016/0024-3795(84)90025-9)
        self._loss = 0.0
        self._allowed = math.sqrt(space.epsilon)

    def start(self, length: float) -> None:
        """Begin anew with rows[0], whose length is given."""
        self.space.scale(1.0 / length, self.rows[0])
        self._loss = self.space.epsilon

    def extend(self, count: int) -> tuple[Array, float, float]:
        """Make v = rows[count] orthonormal to the rows before it.

        Returns (c (count,), |v| at entry, r) with v at entry = sum_s c_s rows[s] + r v at exit.  r
        is 0, and v at exit without meaning, when v lies in the span of the rows to round-off; the
        lengths are not finite when v is not.  Classical Gram-Schmidt, with a second pass where
        cancellation calls for one and then no more ("twice is enough": Parlett, The Symmetric
        Eigenvalue Problem, section 6.9; Giraud, Langou, Rozloznik & van den Eshof 2005,
        doi:10.1007/s00211-005-0615-4).
        """
        products = self.space.project(self.stack, count + 1, self.rows[count])
        square = float(products[count])
        coefficients = products[:count].copy()
        taken = float(coefficients.dot(coefficients))
        rest = square - taken
        if rest >= REMAINDER**2 * square > 0.0:
            loss = self._loss_after(square, taken, rest)
            if loss <= self._allowed:
                self._loss = loss
                return coefficients, math.sqrt(square), self._subtract(coefficients, count, rest)
        if not 0.0 < square < math.inf:
            return coefficients, math.sqrt(square), 0.0 if square == 0.0 else math.nan
        self.space.combine(self.rows[count], self.stack, -coefficients, self.rows[count])
        return self._again(count, coefficients, math.sqrt(square))

    def extend_block(self, count: int, block: int) -> list[tuple[Array, float]]:
        """Make the rows from `count` on, `block` of them, orthonormal, by one reduction.

        Returns (c (count + j,), r) of `extend` for the j-th of them, fewer where r comes out as 0
        or not finite.  What `extend` takes from two passes, it gets vector by vector where the
        products show that cancellation calls for it.  Gram-Schmidt by blocks with a Cholesky
        factorisation inside: Hoemmen 2010, Communication-avoiding Krylov subspace methods,
        section 2.4.
        """
        stack, rows = self.stack, self.rows
        calls = [(stack, count + j + 1, rows[count + j]) for j in range(block)]
        products = self.space.projections(*calls).copy()
        ends = np.cumsum([size for _, size, _ in calls])
        found: list[tuple[Array, float]] = []
        for j, column in enumerate(np.split(products, ends[:-1])):
            for i, (above, length) in enumerate(found):
                shared = column[: count + i].dot(above)
                column[count + i] = (column[count + i] - shared) / length
            taken, square = column[:-1], float(column[-1])
            rest = square - float(taken.dot(taken))
            if not rest >= REMAINDER**2 * square > 0.0:
                break
            loss = self._loss_after(square, float(taken.dot(taken)), rest)
            if loss > self._allowed:
                break
            self._loss = loss
            found.append((taken.copy(), self._subtract(taken, count + j, rest)))
        for j in range(len(found), block):
            c, _, length = self.extend(count + j)
            found.append((c, length))
            if not 0.0 < length < math.inf:
                break
        return found

    def _again(self, count: int, coefficients: Array, before: float) -> tuple[Array, float, float]:
        """The second pass."""
        products = self.space.project(self.stack, count + 1, self.rows[count])
        square = float(products[count])
        correction = products[:count].copy()
        coefficients += correction
        rest = square - float(correction.dot(correction))
        if rest <= max(REMAINDER**2 * square, (10.0 * self.space.epsilon * before) ** 2):
            return coefficients, before, 0.0
        return coefficients, before, self._subtract(correction, count, rest)

    def _subtract(self, coefficients: Array, count: int, rest: float) -> float:
        """Take the components off the vector and normalise it; returns its length before that.

        The length comes from Pythagoras, which there is accurate: the vector is read once less.
        """
        length = math.sqrt(rest)
        row = self.rows[count]
        self.space.combine(row, self.stack, -coefficients, row, 1.0 / length)
        return length

    def _loss_after(self, square: float, taken: float, rest: float) -> float:
        """Bound of |I - V' V| after one pass on a vector: what was lost before is amplified.

        The new row is off the others by |E c| / r + round-off |v| / r, and off length one, because
        of Pythagoras, by c' E c / r^2.
        """
        ratio = math.sqrt(taken / rest)
        growth = self._loss * ratio * max(ratio, 1.0)
        return self._loss + growth + self.space.epsilon * math.sqrt(square / rest)


WINDOW = 2
"""Vectors that a new one is made orthogonal to: all that count for a skew operator, as that of
waves is in the inner product of their energy (Gaudreault, Rainwater & Tokman 2018)."""


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
