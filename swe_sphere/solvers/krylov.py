"""Krylov solvers: initial residual, stopping criteria, results; conjugate gradients."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Self

import warp as wp

from swe_sphere.ranks.limits import check_stop
from swe_sphere.solvers.vector_space import VectorSpace

# An operator reads its first vector and writes its second.
Operator = Callable[[wp.array, wp.array], None]

# Below this many round-offs of the terms that cancel in it, the residual of a recurrence is
# unreliable: it continues to fall when the true residual cannot.
UNTRUSTED = 1e4
# A true residual of so few round-offs of its terms that no longer falls is at its minimum.
MOST_ROUNDOFFS = 1e3
# Fraction of a residual norm down to which later norms follow from products alone.
FALL = 1e-3


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

        most: a larger residual has stagnated; why: the cause of that, for the message; largest:
        residual that may be round-off.
        """
        epsilon = self.space.epsilon
        if p.residual <= p.target and p.target >= UNTRUSTED * epsilon * p.terms:
            p.end(Status.CONVERGED, "converged")
            return
        residual = p.history[-1] = self._true_residual(p)
        roundoffs = (MOST_ROUNDOFFS if residual > most else 1.0) * epsilon
        if not math.isfinite(residual):
            p.end(Status.NAN, "the solution is not finite")
        elif residual <= p.target:
            p.end(Status.CONVERGED, "converged")
        elif residual > 10.0 * p.history[0]:
            p.end(Status.DIVERGED, "diverged: the operator is not linear or nearly singular")
        elif residual <= min(roundoffs * p.terms, largest):
            p.end(Status.CONVERGED, "converged to round-off, not to the tolerance", True)
        elif residual > most:
            p.end(Status.STAGNATED, f"stagnated{why}")
        elif p.iterations >= p.limit:
            p.end(Status.STAGNATED, "out of iterations")


class ConjugateGradients(KrylovSolver):
    """Solver of A x = b for A symmetric and positive in the inner product of the space.

    It holds five vectors, and computes all products at one point of an iteration, where ranks wait
    for each other. Diverged means that the operator or the preconditioner is not positive.

    The method is flexible: the next direction is conjugate to the last one for any preconditioner
    (Golub & Ye 1999, doi:10.1137/S1064827597323415; Notay 2000, doi:10.1137/S1064827599362314). So
    a preconditioner in float32, or one that is not quite symmetric, costs an iteration or two and
    never the solution. Given A z of the preconditioned residual z, all products of an iteration are
    computed at once, and the image A d of the direction is updated by recurrence (Chronopoulos &
    Gear 1989, doi:10.1016/0377-0427(89)90045-9).
    """

    def __init__(self, space: VectorSpace) -> None:
        self.space = space
        self._stack = space.stack(3)
        self._product, self._residual, self._image = (self._stack[k] for k in range(3))
        self._direction, self._preconditioned = space.zeros(), space.zeros()

    def _cycle(self, p: LinearResult) -> None:
        """Descend to the target, and compute the true residual if it may differ."""
        start = p.residual
        self._descend(p, max(p.target, self.space.epsilon * p.terms))
        if p.status is None:
            self._judge(p, 0.5 * start)

    def _descend(self, p: LinearResult, goal: float) -> None:
        """Iterate from the stored residual until it is down to the goal, or fails.

        Products are named by their vectors: r the residual, z = M r, w = A z, d the last direction
        and s = A d.
        """
        space, r, s, w, curvature = self.space, self._residual, self._product, self._image, 0.0
        space.clear(self._direction)
        space.clear(s)
        while p.residual > goal and p.iterations < p.limit:
            check_stop()
            z = r if p.precondition is None else self._preconditioned
            if p.precondition is not None:
                p.precondition(r, z)
            p.operator(z, w)
            stack = self._stack
            found = space.projections((stack, 3, z), (stack, 3, w), (stack, 2, r), (stack, 1, s))
            sz, rz, wz, sw, rw, ww, sr, rr, ss = map(float, found)
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
            space.axpby(1.0, z, keep, self._direction)
            space.axpby(1.0, w, keep, s)
            space.axpy(step, self._direction, p.x)
            space.axpy(-step, s, r)
            p.iterations += 1
            # |r - step (w + keep s)|^2
            square = ww + keep * (2.0 * sw + keep * ss)
            rest = rr - step * (2.0 * (rw + keep * sr) - step * square)
            if rest <= FALL**2 * rr:  # the norm has lost digits by cancellation
                rest = space.dot(r, r)
            p.history.append(math.sqrt(rest))
