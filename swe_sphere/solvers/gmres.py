"""Flexible GMRES, the Krylov solver of every implicit step, and the Arnoldi bases of solvers.

Saad (1993), A flexible inner-outer preconditioned GMRES algorithm, SIAM J. Sci. Comput. 14,
461-469, doi:10.1137/0914028. The preconditioner acts from the right, so that the monitored residual
is that of the problem itself, and the method is flexible, so that the preconditioner may change
from one iteration to the next.
"""

import math
from collections.abc import Sequence

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.ranks.limits import check_stop
from swe_sphere.solvers.krylov import KrylovSolver, LinearResult, Status
from swe_sphere.solvers.vector_space import VectorSpace

# Columns that lower the residual by less than this fraction are not used.
GAIN = 1e-6
# A second pass follows at the latest if the first leaves less than this fraction of a vector.
REMAINDER = 0.1
WINDOW = 2
"""Number of vectors that a short basis orthogonalises against; this suffices for a skew
operator, as that of waves is in the inner product of their energy (Gaudreault, Rainwater & Tokman
2018)."""


class KrylovBasis:
    """Memory for `size` vectors; `rows[k]` is the k-th, in the memory of `stack` (size, n).

    A vector is made orthogonal to all vectors before it, or to the last WINDOW in a short basis.
    """

    def __init__(self, space: VectorSpace, size: int, short: bool = False) -> None:
        self.space, self._short = space, short
        self.stack = space.room(size)
        self.rows = [self.stack[k] for k in range(size)]
        self._firsts = [max(0, k - WINDOW) if short else 0 for k in range(size)]
        self._stacks = [self.stack[first:] if first else self.stack for first in self._firsts]
        # bound of |I - V' V|, and its limit: semi-orthogonality suffices for the projections
        # (Simon 1984, doi:10.1016/0024-3795(84)90025-9)
        self._loss = 0.0
        self._allowed = math.sqrt(space.epsilon)

    def start(self, length: float) -> None:
        """Restart with rows[0], whose length is given."""
        self.space.scale(1.0 / length, self.rows[0])
        self._loss = self.space.epsilon

    def extend(self, count: int) -> tuple[Array, float]:
        """Make v = rows[count] orthonormal to the k rows that its orthogonalisation uses.

        Returns (c (k,), r) with v at entry = sum_s c_s rows[s] + r v at exit. r is 0, and v at exit
        meaningless, if v lies in the span of the rows to round-off; r is not finite if v is not.
        Classical Gram-Schmidt, with a single second pass after cancellation ("twice is enough":
        Parlett, The Symmetric Eigenvalue Problem, section 6.9; Giraud, Langou, Rozloznik & van den
        Eshof 2005, doi:10.1007/s00211-005-0615-4).
        """
        c, square = self._project(count)
        rest = square - float(c.dot(c))
        if rest >= REMAINDER**2 * square > 0.0 and self._stays_orthogonal(square, rest):
            return c, self._subtract(count, c, rest)
        if not 0.0 < square < math.inf:
            return c, 0.0 if square == 0.0 else math.nan
        row = self.rows[count]
        self.space.combine(row, self._stacks[count], -c, row)
        more, left = self._project(count)
        rest = left - float(more.dot(more))
        if rest <= max(REMAINDER**2 * left, (10.0 * self.space.epsilon) ** 2 * square):
            return c + more, 0.0
        return c + more, self._subtract(count, more, rest)

    def _project(self, count: int) -> tuple[Array, float]:
        """Return the products of a row with the rows before it, and with itself."""
        size = count - self._firsts[count] + 1
        products = self.space.projections((self._stacks[count], size, self.rows[count]))
        return products[:-1].copy(), float(products[-1])

    def _stays_orthogonal(self, square: float, rest: float) -> bool:
        """Return whether one pass, after which `rest` of `square` remains, keeps orthogonality.

        The pass amplifies an earlier loss of orthogonality: the products of the new row with the
        others become |E c| / r + round-off |v| / r, and its length differs from one, by Pythagoras,
        by c' E c / r^2.
        """
        if self._short:
            return True
        ratio = math.sqrt((square - rest) / rest)
        growth = self._loss * ratio * max(ratio, 1.0)
        loss = self._loss + growth + self.space.epsilon * math.sqrt(square / rest)
        if not loss <= self._allowed:
            return False
        self._loss = loss
        return True

    def _subtract(self, count: int, c: Array, rest: float) -> float:
        """Subtract the components from the vector and normalise it; return its length before that.

        The length comes from Pythagoras, which is accurate here and saves one pass over the vector.
        """
        length, row = math.sqrt(rest), self.rows[count]
        self.space.combine(row, self._stacks[count], -c, row, 1.0 / length)
        return length


class HessenbergLeastSquares:
    """Solves min_y |beta e_1 - H y| for an upper Hessenberg H (k + 1, k) that grows by columns.

    Saad, Iterative Methods for Sparse Linear Systems (2003), section 6.5.3. Python floats are
    faster than numpy at the sizes of a Krylov basis. A diagonal entry of the triangle that
    cancelled to round-off (epsilon) counts as zero, and its component of y as undetermined.
    """

    def __init__(self, beta: float, epsilon: float) -> None:
        self._epsilon = epsilon
        self._columns: list[list[float]] = []
        self._rotations: list[tuple[float, float]] = []
        self._rhs = [beta]
        self._residuals = [beta]
        self._sizes: list[float] = []

    def append(self, column: Sequence[float], below: float) -> float:
        """Add the column H[:k, k-1], H[k, k-1] = below; return the least |beta e_1 - H y|."""
        c = list(column)
        for i, (cosine, sine) in enumerate(self._rotations):
            c[i], c[i + 1] = cosine * c[i] + sine * c[i + 1], cosine * c[i + 1] - sine * c[i]
        diagonal = math.hypot(c[-1], below)
        # at a breakdown (below = 0) this entry of an ill-conditioned H is noise
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
        """Return the minimising y, its residual, and the size of the terms that cancel in H y.

        y is shorter than H is wide if the last columns gain nothing, or less than their round-off
        in those terms, sum_k |y_k| |H e_k|, costs; this happens if the operator is singular.
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
        """Return y for the first `count` columns, by back substitution, and the terms' size."""
        y = self._rhs[:count]
        for k in range(count - 1, -1, -1):
            column = self._columns[k]
            y[k] = y[k] / column[k] if column[k] > 0.0 else 0.0
            for i in range(k):
                y[i] -= column[i] * y[k]
        return y, math.fsum(abs(a * b) for a, b in zip(y, self._sizes, strict=False))


class FlexibleGMRES(KrylovSolver):
    """Solver of A x = b with `size` basis vectors; keep the instance, as it allocates only once.

    Memory: (size + 1) vectors, and `size` more from the first preconditioned solve on; a CPU uses
    only as many of each as the longest cycle so far. If a vector becomes non-finite, x keeps its
    value at the last restart.
    """

    def __init__(self, space: VectorSpace, size: int = 30) -> None:
        """Allocate the basis; raises ConfigError for a size below 1."""
        if size < 1:
            raise ConfigError(f"GMRES needs at least one basis vector, got {size}")
        self.space, self.size = space, size
        self._basis = KrylovBasis(space, size + 1)
        self._residual = self._basis.rows[0]
        self._images: wp.array | None = None
        self._image_rows: list[wp.array] = []

    def _cycle(self, p: LinearResult) -> None:
        """Iterate from the residual in row 0 until met, full or broken down; then update x."""
        start, rows, epsilon = p.residual, self._basis.rows, self.space.epsilon
        if p.precondition is not None and self._images is None:
            self._images = self.space.room(self.size)
            self._image_rows = [self._images[i] for i in range(self.size)]
        small, goal = HessenbergLeastSquares(start, epsilon), max(p.target, epsilon * start)
        self._basis.start(start)
        met = broken = False
        for k in range(min(self.size, p.limit - p.iterations)):
            check_stop()
            direction = rows[k]
            if p.precondition is not None:  # a flexible method cannot find M v_k again
                p.precondition(direction, self._image_rows[k])
                direction = self._image_rows[k]
            p.operator(direction, rows[k + 1])
            column, below = self._basis.extend(k + 1)
            if not (math.isfinite(below) and np.isfinite(column).all()):
                p.end(Status.NAN, "a product or the preconditioner is not finite")
                return
            p.history.append(small.append(column.tolist(), below))
            p.iterations += 1
            met, broken = p.residual <= goal, below == 0.0 and p.residual > goal
            if met or broken:
                break
        stack = self._basis.stack if p.precondition is None else self._images
        y, p.history[-1], terms = small.solve()
        self.space.combine(p.x, stack, y, p.x)
        p.terms += terms
        # a full basis may converge slowly; any other cycle should gain far more than a half
        most = (0.5 if met or broken else 0.999) * start
        largest = math.sqrt(epsilon) * p.scale
        self._judge(p, most, ": the operator is singular" * broken, largest)
