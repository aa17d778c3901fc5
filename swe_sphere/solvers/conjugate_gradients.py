"""Conjugate gradients for the symmetric Helmholtz problems of semi-implicit steps.

Flexible: the next direction is made conjugate to the last one whatever the preconditioner does
(Golub & Ye 1999, Inexact preconditioned conjugate gradient method with inner-outer iteration,
doi:10.1137/S1064827597323415; Notay 2000, doi:10.1137/S1064827599362314).  So a preconditioner in
float32, or one that is not quite symmetric, costs an iteration or two and never the answer.  With
A z of the preconditioned residual z at hand, all products of an iteration are taken at once, and
the image A d of the direction is carried on (Chronopoulos & Gear 1989,
doi:10.1016/0377-0427(89)90045-9).
"""

import math
from typing import NamedTuple

import warp as wp

from swe_sphere.solvers.linear_result import KrylovSolver, LinearResult, Status
from swe_sphere.solvers.vector_space import VectorSpace

# The residual of the recurrence is not believed below this many round-offs of the terms of the true
# one, and a residual of so few round-offs that no longer falls is as small as it gets; below one of
# them is nothing to descend to.
UNTRUSTED, MOST_ROUNDOFFS = 1e4, 1e3
FALL = 1e-3
"""Part of a residual norm down to which those after it are told from products alone."""


class ConjugateGradients(KrylovSolver):
    """Solver of A x = b for A symmetric and positive in the inner product of the space.

    It holds five vectors, and takes products at one place an iteration: ranks wait there for each
    other.  Diverged means that the operator or the preconditioner is not positive.
    """

    def __init__(self, space: VectorSpace) -> None:
        self.space = space
        self._stack = space.stack(3)
        self._product, self._residual, self._image = (self._stack[k] for k in range(3))
        self._direction, self._preconditioned = space.zeros(), space.zeros()
        self._least = math.sqrt(space.epsilon)

    def _cycle(self, p: LinearResult) -> None:
        """Descend to the target, and judge by the true residual where it may be another one."""
        smallest, start = self.space.epsilon * p.terms, p.residual
        self._descend(p, max(p.target, smallest))
        if p.status is not None:
            return
        if p.residual <= p.target and p.target >= UNTRUSTED * smallest:
            p.end(Status.CONVERGED, "converged")
            return
        residual = p.history[-1] = self._true_residual(p)
        small = smallest if residual <= 0.5 * start else MOST_ROUNDOFFS * smallest
        if not math.isfinite(residual):
            p.end(Status.NAN, "the solution is not finite")
        elif residual <= p.target:
            p.end(Status.CONVERGED, "converged")
        elif residual <= small:
            p.end(Status.CONVERGED, "converged to round-off, not to the tolerance", True)
        elif residual > 0.5 * start or p.iterations >= p.limit:
            p.end(Status.STAGNATED, "stagnated")

    def _descend(self, p: LinearResult, goal: float) -> None:
        """Iterate from the residual in place until it is down to the goal, or fails."""
        space, curvature = self.space, 0.0
        space.clear(self._direction)
        space.clear(self._product)
        while p.residual > goal and p.iterations < p.limit:
            z = self._residual
            if p.precondition is not None:
                z = self._preconditioned
                p.precondition(self._residual, z)
            p.operator(z, self._image)
            found = self._products(z)
            keep, curvature = found.turned(curvature, self._least)
            step = found.rz / (curvature or 1.0)
            if not (math.isfinite(step) and math.isfinite(curvature)):
                p.end(Status.NAN, "a product or the preconditioner is not finite")
                return
            if found.rz <= 0.0 or curvature <= 0.0:
                culprit = "preconditioner" if found.rz <= 0.0 else "operator"
                p.end(Status.DIVERGED, f"the {culprit} is not positive")
                return
            space.axpby(1.0, z, keep, self._direction)
            space.axpby(1.0, self._image, keep, self._product)
            space.axpy(step, self._direction, p.x)
            space.axpy(-step, self._product, self._residual)
            p.iterations += 1
            rest = found.left(keep, step)
            if rest <= FALL**2 * found.rr:  # little is left of what cancels
                rest = space.dot(self._residual, self._residual)
            p.history.append(math.sqrt(rest))

    def _products(self, z: wp.array) -> "_Products":
        s, r, w = (self._stack, 1, self._product), (self._stack, 2, self._residual), self._image
        products = self.space.projections((self._stack, 3, z), (self._stack, 3, w), r, s)
        return _Products(*map(float, products))

    def _true_residual(self, p: LinearResult) -> float:
        """Put rhs - A x in place; returns its norm."""
        p.operator(p.x, self._residual)
        self.space.axpby(1.0, p.rhs, -1.0, self._residual)
        return self.space.norm(self._residual)


class _Products(NamedTuple):
    """Of the residual r, z = M r, w = A z, and s = A d, where d is the direction before."""

    sz: float
    rz: float
    wz: float
    sw: float
    rw: float
    ww: float
    sr: float
    rr: float
    ss: float

    def turned(self, curvature: float, least: float) -> tuple[float, float]:
        """How much of d to add to z, to be conjugate to d, and <., A .> of that; from that of d."""
        keep = -self.sz / curvature if curvature else 0.0
        found = self.wz + keep * self.sz
        return (keep, found) if abs(found) > least * abs(self.wz) else (0.0, self.wz)

    def left(self, keep: float, step: float) -> float:
        """|r - step (w + keep s)|^2."""
        across = self.rw + keep * self.sr
        square = self.ww + keep * (2.0 * self.sw + keep * self.ss)
        return self.rr - step * (2.0 * across - step * square)
