"""Krylov solvers: conjugate gradients, flexible GMRES and the Arnoldi bases of other solvers.

GMRES: Saad (1993), A flexible inner-outer preconditioned GMRES algorithm, SIAM J. Sci. Comput. 14,
461-469, doi:10.1137/0914028. Right preconditioning, so that the monitored residual is that of the
problem itself; flexible, so that the preconditioner may change between iterations.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Self

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.equations.right_hand_side import Operator
from swe_sphere.errors import ConfigError
from swe_sphere.ranks.limits import check_stop
from swe_sphere.solvers.vector_space import VectorSpace

UNTRUSTED = 1e4
"""Below this many round-offs of the terms that cancel in it, the residual of a recurrence is
unreliable: it continues to fall when the true residual cannot."""
MOST_ROUNDOFFS = 1e3
"""A true residual of so few round-offs of its terms that no longer falls is at its minimum."""
FALL = 1e-3
"""Fraction of the last residual norm below which the next one, from products alone, is inexact."""
NOISE = 1e-6
"""Fraction of its terms below which a residual may be noise to a preconditioner in float32."""


class Status(Enum):
    """Status of a solve at its end."""

    CONVERGED = "converged"
    STAGNATED = "stagnated"
    DIVERGED = "diverged"
    NAN = "NaN"


@dataclass(kw_only=True)
class SolveResult(ABC):
    """A solve, in progress or finished.

    history: norms of the residual, in the norm of the space, at the start and after each iteration.
    target: residual norm that ends the solve. roundoff: the solution is as accurate as the
    arithmetic allows but misses the tolerance; the status is CONVERGED then.
    """

    history: list[float]
    target: float
    status: Status | None = None
    message: str = ""
    roundoff: bool = False

    @property
    @abstractmethod
    def counts(self) -> str:
        """Return iterations and residuals for the message."""

    def end(self, status: Status, message: str, roundoff: bool = False) -> Self:
        """Return this result with its status, and its message with counts and residuals."""
        self.status, self.roundoff = status, roundoff
        self.message = f"{message} ({self.counts})"
        return self

    @property
    def converged(self) -> bool:
        """True if the residual met the target, or is round-off."""
        return self.status is Status.CONVERGED

    @property
    def residual(self) -> float:
        return self.history[-1]


@dataclass(kw_only=True)
class LinearResult(SolveResult):
    """A solve of operator(x) = rhs.

    scale: norm of the right-hand side; limit: largest number of iterations; guess: True if it began
    from a nonzero x; terms: size of the terms whose difference is the residual. Within a cycle the
    history contains the residuals of the recurrence; at a restart, and if a tolerance approaches
    round-off, they are recomputed from the solution.
    """

    operator: Operator
    precondition: Operator | None
    rhs: wp.array
    x: wp.array
    scale: float
    limit: int
    guess: bool
    iterations: int = 0
    terms: float = 0.0

    @property
    def counts(self) -> str:
        relative = self.residual / (self.scale or 1.0)
        return f"{self.iterations} iterations, relative residual {relative:.1e}"


class KrylovSolver(ABC):
    """Solver of A x = b; keep the instance, as it allocates only once."""

    space: VectorSpace
    _residual: wp.array
    """Vector that starts the iterations."""

    def solve(
        self, operator: Operator, rhs: wp.array, x: wp.array, precondition: Operator | None = None,
        rtol: float = 1e-6, max_iterations: int = 200, scale: float | None = None,
        guess: bool = True,
    ) -> LinearResult:  # fmt: skip
        """Solve operator(x) = rhs (n,) from the guess x, which is replaced by the solution.

        operator(v, out) must be linear; precondition(r, out) is an approximate inverse of it, which
        may vary. Both receive vectors of this solver: they must not write to the first one nor keep
        either. Converged means |rhs - A x| <= rtol |rhs| [norm of the space]; a tolerance below the
        accuracy of the arithmetic, 0 included, is met by a residual of round-off size, and the
        result then sets `roundoff`. scale: |rhs| if it is known; guess: False if x contains no
        guess and stands for 0. x never receives a value that is not finite.
        """
        scale = self.space.norm(rhs) if scale is None else scale
        p = LinearResult(
            history=[], target=rtol * scale, operator=operator, rhs=rhs, x=x,
            precondition=precondition, scale=scale, limit=max_iterations, guess=guess,
        )  # fmt: skip
        if scale == 0.0 or not guess:
            self.space.clear(x)
        if scale == 0.0:
            p.history.append(0.0)
            return p.end(Status.CONVERGED, "the right-hand side is zero")
        p.history.append(self._true_residual(p) if math.isfinite(scale) else scale)
        if not math.isfinite(p.residual):
            return p.end(Status.NAN, "the right-hand side or the guess is not finite")
        if p.residual <= p.target:
            return p.end(Status.CONVERGED, "the guess is good enough")
        p.terms = max(scale, p.residual)
        while p.status is None:
            self._cycle(p)
        return p

    @abstractmethod
    def _cycle(self, p: LinearResult) -> None:
        """Iterate up to the next true residual; end the solve there if nothing is to be gained."""

    def _true_residual(self, p: LinearResult) -> float:
        """Store rhs - A x in the vector that starts iterations; return its norm."""
        if not p.history and not p.guess:
            self.space.copy(p.rhs, self._residual)
            return p.scale
        p.operator(p.x, self._residual)
        self.space.axpby(1.0, p.rhs, -1.0, self._residual)
        return self.space.norm(self._residual)

    def _judge(
        self, p: LinearResult, most: float, why: str = "", largest: float = math.inf
    ) -> None:
        """End the solve if the residual after a cycle requires it.

        most: a solve with a larger residual has stagnated; why: cause of stagnation, for the
        message; largest: largest residual that may be round-off.
        """
        if p.residual <= p.target and p.target >= UNTRUSTED * self.space.epsilon * p.terms:
            p.end(Status.CONVERGED, "converged")
            return
        residual = p.history[-1] = self._true_residual(p)
        roundoffs = (MOST_ROUNDOFFS if residual > most else 1.0) * self.space.epsilon
        if not math.isfinite(residual):
            p.end(Status.NAN, "the solution is not finite")
        elif residual <= p.target:
            p.end(Status.CONVERGED, "converged")
        elif residual <= min(roundoffs * p.terms, largest):
            p.end(Status.CONVERGED, "converged to round-off, not to the tolerance", True)
        elif p.iterations >= p.limit:
            p.end(Status.STAGNATED, "out of iterations")
        elif residual > 10.0 * p.history[0]:
            p.end(Status.DIVERGED, "diverged: the operator is not linear or nearly singular")
        elif residual > most:
            p.end(Status.STAGNATED, f"stagnated{why}")


class ConjugateGradients(KrylovSolver):
    """Solver of A x = b for A symmetric and positive in the inner product of the space.

    It holds five vectors, and computes all products at one point of an iteration, where ranks wait
    for each other. Diverged means that the operator or the preconditioner is not positive, or that
    the true residual grew tenfold.

    The method is flexible: the next direction is conjugate to the last one for any preconditioner
    (Golub & Ye 1999, doi:10.1137/S1064827597323415; Notay 2000, doi:10.1137/S1064827599362314). So
    a preconditioner in float32, or one that is not quite symmetric, adds an iteration or two but no
    error. Given A z of the preconditioned residual z, all products of an iteration are computed at
    once, and the image A d of the direction is updated by recurrence (Chronopoulos & Gear 1989,
    doi:10.1016/0377-0427(89)90045-9).
    """

    def __init__(self, space: VectorSpace) -> None:
        self.space = space
        self._stack = space.stack(3)
        self._image, self._residual, self._product = (self._stack[k] for k in range(3))
        self._direction, self._preconditioned = space.zeros(), space.zeros()

    def _cycle(self, p: LinearResult) -> None:
        """Descend to the target, and compute the true residual if it may differ."""
        start = p.residual
        self._descend(p, max(p.target, self.space.epsilon * p.terms))
        if p.status is None:
            self._judge(p, 0.5 * start)

    def _descend(self, p: LinearResult, goal: float) -> None:
        """Iterate from the stored residual until it is down to the goal, or fails.

        Products are named by vectors: r the residual, z = M r, w = A z, d last direction, s = A d.
        """
        space, r, s, w, curvature = self.space, self._residual, self._image, self._product, 0.0
        precondition, noise, stack = p.precondition, NOISE * p.terms, self._stack
        space.clear(self._direction)
        space.clear(s)
        while p.residual > goal and p.iterations < p.limit:
            check_stop()
            z = r if precondition is None else self._preconditioned
            if precondition is not None:
                precondition(r, z)
            p.operator(z, w)
            found = space.projections((stack, 3, z), (stack, 3, w), (stack, 2, r), (stack, 1, s))
            sz, rz, wz, sw, rw, ww, sr, rr, ss = map(float, found)
            if precondition is not None and rz <= 0.0 and p.residual < noise:
                precondition = None
                continue
            # multiple of d that makes z conjugate to d, and <., A .> of the sum
            keep = -sz / curvature if curvature else 0.0
            curvature = wz + keep * sz
            if not abs(curvature) > math.sqrt(space.epsilon) * abs(wz):
                keep, curvature = 0.0, wz
            step = rz / (curvature or 1.0)
            if not (math.isfinite(step) and math.isfinite(curvature)):
                p.end(Status.NAN, "a product or the preconditioner is not finite")
                return
            if rz <= 0.0 or curvature <= 0.0:
                culprit = "preconditioner" if rz <= 0.0 else "operator"
                p.end(Status.DIVERGED, f"the {culprit} is not positive")
                return
            # |r - t (w + keep s)|^2 = rr - t (2 rq - t square)
            rq, square = rw + keep * sr, ww + keep * (2.0 * sw + keep * ss)
            if FALL**2 * rr * square < rr * square - rq * rq <= goal**2 * square:
                step = rq / square  # the last step is the one that leaves the least residual
            rest = rr - step * (2.0 * rq - step * square)
            space.axpby(1.0, z, keep, self._direction)
            space.axpy(step, self._direction, p.x)
            p.iterations += 1
            if FALL**2 * rr < rest <= goal**2:  # no further direction needs r and s
                p.history.append(min(math.sqrt(rest), goal))
                return
            space.axpby(1.0, w, keep, s)
            space.axpy(-step, s, r)
            if rest <= FALL**2 * rr:  # the norm has lost digits by cancellation
                rest = space.dot(r, r)
            p.history.append(math.sqrt(rest))


GAIN = 1e-6
"""Columns that lower the residual by less than this fraction are not used."""
REMAINDER, INSIDE, MOST_PASSES = 0.1, 0.01, 5
"""A second pass follows at the latest if the first leaves less than the fraction REMAINDER of a
vector, a further one if more than the fraction INSIDE of the rest lies in the span."""
LOSS = 0.03
"""Largest |I - V' V| in GMRES, by which fraction a residual may differ from its estimate."""
WINDOW = 2
"""Number of vectors that a short basis orthogonalises against, as suffices for a skew operator:
waves are skew in the inner product of their energy (Gaudreault, Rainwater & Tokman 2018)."""


class KrylovBasis:
    """Memory for `size` vectors; `rows[k]` is the k-th, in the memory of `stack` (size, n).

    A vector is made orthogonal to all vectors before it, or to the last WINDOW in a short basis.
    most_loss: largest deviation |I - V' V|; by default that of a semi-orthogonal basis, which
    suffices for projections accurate to round-off (Simon 1984, doi:10.1016/0024-3795(84)90025-9).
    """

    def __init__(
        self, space: VectorSpace, size: int, short: bool = False, most_loss: float | None = None
    ) -> None:
        self.space, self._short = space, short
        self.stack = space.empty_stack(size)
        self.rows = [self.stack[k] for k in range(size)]
        self._firsts = [max(0, k - WINDOW) if short else 0 for k in range(size)]
        self._stacks = [self.stack[first:] if first else self.stack for first in self._firsts]
        self._most_loss = math.sqrt(space.epsilon) if most_loss is None else most_loss
        self.loss = 0.0
        """Bound of |I - V' V| so far."""

    def start(self, length: float) -> None:
        """Restart from rows[0], whose norm is `length`, and normalise it."""
        self.space.scale(1.0 / length, self.rows[0])
        self.loss = self.space.epsilon

    def extend(self, count: int) -> tuple[Array, float]:
        """Make v = rows[count] orthonormal to the k rows that its orthogonalisation uses.

        Returns (c (k,), r) with v at entry = sum_s c_s (row s of these k) + r v at exit. r is 0 and
        v at exit meaningless if v lies in their span to round-off; r is not finite if v is not.
        Classical Gram-Schmidt, with a second pass after cancellation; it is enough for orthogonal
        rows (Parlett, The Symmetric Eigenvalue Problem, section 6.9; Giraud, Langou, Rozloznik &
        van den Eshof 2005, doi:10.1007/s00211-005-0615-4), and others may need a further one.
        """
        c, square = self._project(count)
        rest = square - float(c.dot(c))
        if rest >= REMAINDER**2 * square > 0.0 and self._stays_orthogonal(square, rest):
            return c, self._subtract(count, c, rest)
        if not 0.0 < square < math.inf:
            return c, 0.0 if square == 0.0 else math.nan
        row, more = self.rows[count], c
        for _ in range(1, MOST_PASSES):
            self.space.combine(row, self._stacks[count], -more, row)
            more, left = self._project(count)
            c, inside = c + more, float(more.dot(more))
            if left <= (10.0 * self.space.epsilon) ** 2 * square:
                break
            if not inside > INSIDE**2 * left:  # also NaN
                return c, self._subtract(count, more, left - inside)
        return c, 0.0

    def _project(self, count: int) -> tuple[Array, float]:
        """Return the products of a row with the rows before it, and with itself."""
        size = count - self._firsts[count] + 1
        products = self.space.projections((self._stacks[count], size, self.rows[count]))
        return products[:-1].copy(), float(products[-1])

    def _stays_orthogonal(self, square: float, rest: float) -> bool:
        """Return whether one pass, which leaves `rest` of `square`, is enough; record its loss.

        The pass amplifies an earlier loss of orthogonality: products of the new row with the others
        become |E c| / r + round-off |v| / r, and its length differs from one by c' E c / r^2.
        """
        if self._short:
            return True
        ratio = math.sqrt((square - rest) / rest)
        growth = self.loss * ratio * max(ratio, 1.0)
        loss = self.loss + growth + self.space.epsilon * math.sqrt(square / rest)
        if not loss <= self._most_loss:
            return False
        self.loss = loss
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
        self._rhs, self._residuals = [beta], [beta]
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

        y omits the last columns if they reduce the residual by less than GAIN, or by less than the
        round-off of the terms sum_k |y_k| |H e_k|, as for a singular operator.
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

    Memory: (size + 1) vectors, and `size` more from the first preconditioned solve on; on a CPU
    only rows used so far occupy it. If a vector is not finite, x keeps its last value.
    """

    def __init__(self, space: VectorSpace, size: int = 30) -> None:
        """Allocate the basis; raises ConfigError for a size below 1."""
        if size < 1:
            raise ConfigError(f"GMRES needs at least one basis vector, got {size}")
        self.space, self.size = space, size
        self._basis = KrylovBasis(space, size + 1, most_loss=LOSS)
        self._residual = self._basis.rows[0]
        self._images: wp.array | None = None
        self._image_rows: list[wp.array] = []

    def _cycle(self, p: LinearResult) -> None:
        """Iterate from the residual in row 0 until met, full or broken down; then update x."""
        start, rows, epsilon = p.residual, self._basis.rows, self.space.epsilon
        if p.precondition is not None and self._images is None:
            self._images = self.space.empty_stack(self.size)
            self._image_rows = [self._images[i] for i in range(self.size)]
        small = HessenbergLeastSquares(start, epsilon)
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
            goal = max((1.0 - self._basis.loss) * p.target, epsilon * start)
            met, broken = p.residual <= goal, below == 0.0 and p.residual > goal
            if met or broken:
                break
        stack = self._basis.stack if p.precondition is None else self._images
        y, p.history[-1], terms = small.solve()
        self.space.combine(p.x, stack, y, p.x)
        p.terms += terms
        # a full basis may converge slowly; any other cycle should gain far more than a half
        most = (0.5 if met or broken else 0.999) * start
        self._judge(p, most, ": the operator is singular" * broken, math.sqrt(epsilon) * p.scale)
