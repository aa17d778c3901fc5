"""Flexible GMRES: the Krylov solver under every implicit step.

Saad (1993), A flexible inner-outer preconditioned GMRES algorithm, SIAM J. Sci. Comput. 14,
461-469, doi:10.1137/0914028.  Preconditioned from the right, so that the residual it watches is the
one of the problem itself, and flexible, so that the preconditioner may change from one iteration to
the next.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.solvers.krylov_basis import KrylovBasis
from swe_sphere.solvers.linear_result import KrylovSolver, LinearResult, Status
from swe_sphere.solvers.vector_space import VectorSpace

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


class FlexibleGMRES(KrylovSolver):
    """Solver of A x = b with room for `size` basis vectors; keep it, it allocates once.

    Memory: (size + 1) vectors, and `size` more from the first preconditioned solve on; on a CPU
    only as many of each as the longest cycle so far has had.  After anything not finite, x is as it
    was at the last restart.
    """

    def __init__(self, space: VectorSpace, size: int = 30, block: int = 1) -> None:
        """Raises ConfigError for a size or a block below 1.

        block: iterations that share one reduction; up to block - 1 products of the last are for
        nothing.  Chronopoulos & Kim 1990, s-step Orthomin and GMRES, Reliable Computing 4.
        """
        if size < 1:
            raise ConfigError(f"GMRES needs room for at least one basis vector, not {size}")
        if block < 1:
            raise ConfigError(f"a Krylov block has at least one vector, not {block}")
        self.space, self.size, self.block = space, size, block
        self._basis = KrylovBasis(space, size + 1)
        self._residual = self._basis.rows[0]
        self._images: wp.array | None = None
        self._image_rows: list[wp.array] = []

    def _cycle(self, p: LinearResult) -> None:
        """Arnoldi from the residual in row 0 until met, full or broken down; then update x."""
        start, rows = p.residual, self._basis.rows
        kept = p.precondition is not None or self.block > 1
        if kept and self._images is None:  # a flexible method cannot find M v_k again
            self._images = self.space.room(self.size)
            self._image_rows = [self._images[i] for i in range(self.size)]
        small = HessenbergLeastSquares(start, self.space.epsilon)
        goal = max(p.target, self.space.epsilon * start)
        self._basis.start(start)
        met, broken, count = False, False, min(self.size, p.limit - p.iterations)
        for k in range(0, count, self.block):
            block = range(k, min(k + self.block, count))
            for j in block:
                direction, product = rows[j : j + 2]
                if p.precondition is not None:
                    p.precondition(direction, self._image_rows[j])
                    direction = self._image_rows[j]
                elif kept:  # the row becomes a vector of the basis
                    self.space.copy(direction, self._image_rows[j])
                p.operator(direction, product)
                if self.block > 1:
                    self.space.axpby(-1.0, rows[j], 1.0, product)
            for column, below in self._columns(k, len(block)):
                if not (math.isfinite(below) and np.isfinite(column).all()):
                    p.end(Status.NAN, "a product or the preconditioner is not finite")
                    return
                p.history.append(small.append(column.tolist(), below))
                p.iterations += 1
                met, broken = p.residual <= goal, below == 0.0 and p.residual > goal
                if met or broken:
                    break
            if met or broken:
                break
        stack = self._images if kept else self._basis.stack
        y, p.history[-1], terms = small.solve()
        self.space.combine(p.x, stack, y, p.x)
        p.terms += terms
        # a full basis may creep; any other cycle is expected to gain far more than a half
        most = (0.5 if met or broken else 0.999) * start
        largest = math.sqrt(self.space.epsilon) * p.scale
        self._judge(p, most, ": the operator is singular" * broken, largest)

    def _columns(self, k: int, block: int) -> Iterator[tuple[Array, float]]:
        """Columns of H for the products from row k + 1 on, each with the entry below it.

        Blocks are of vectors p_0 = v_k, p_j+1 = (A M - 1) p_j, orthonormal afterwards.  Where M is
        near A^-1 these are less alike than the powers of A M.  H then describes A M of p_j, not of
        v_k+j, and x is made of M p_j.
        """
        if self.block == 1:
            yield self._basis.extend(k + 1)
            return
        shifted = np.zeros(k + 1)
        shifted[k] = 1.0
        for column, below in self._basis.extend_block(k + 1, block):
            yield column + shifted, below
            shifted = np.append(column, below)
