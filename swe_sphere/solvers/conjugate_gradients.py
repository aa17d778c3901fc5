"""Conjugate gradients for the symmetric Helmholtz problems of semi-implicit steps.

Flexible: the next direction is found by the formula of Polak and Ribiere, which keeps it conjugate
to the last one whatever the preconditioner does (Golub & Ye 1999, Inexact preconditioned conjugate
gradient method with inner-outer iteration, doi:10.1137/S1064827597323415; Notay 2000,
doi:10.1137/S1064827599362314).  So a preconditioner in float32, or one that is not quite symmetric,
costs an iteration or two and never the answer.
"""

import math

import warp as wp

from swe_sphere.solvers.linear_result import KrylovSolver, LinearResult, LinearSolve, Status
from swe_sphere.solvers.vector_space import VectorSpace

# The residual of the recurrence is not believed below this many round-offs of the terms of the true
# one, and a residual of so few round-offs that no longer falls is as small as it gets; below one of
# them is nothing to descend to.
UNTRUSTED, MOST_ROUNDOFFS = 1e4, 1e3
FALL = 1e-3
"""Part of a residual norm down to which those after it are told from products alone."""


class ConjugateGradients(KrylovSolver):
    """Solver of A x = b for A symmetric and positive in the inner product of the space.

    It holds four vectors, and takes products at two places an iteration: ranks wait there for each
    other.  Diverged means that the operator or the preconditioner is not positive.
    """

    def __init__(self, space: VectorSpace) -> None:
        self.space = space
        self._stack = space.stack(3)
        self._residual, self._product, self._direction = (self._stack[k] for k in range(3))
        self._preconditioned = space.zeros()

    def _iterate(self, p: LinearSolve) -> LinearResult:
        """Descents until the target is met or nothing more is to be gained."""
        smallest = self.space.epsilon * p.terms
        trusted = p.target >= UNTRUSTED * smallest
        while True:
            start = p.history[-1]
            failure = self._descend(p, max(p.target, smallest))
            if failure is not None:
                return failure
            if p.history[-1] <= p.target and trusted:
                return p.end(Status.CONVERGED, "converged")
            residual = p.history[-1] = self._true_residual(p)
            if residual <= p.target:
                return p.end(Status.CONVERGED, "converged")
            small = smallest if residual <= 0.5 * start else MOST_ROUNDOFFS * smallest
            if residual <= small:
                return p.end(Status.CONVERGED, "converged to round-off, not to the tolerance", True)
            if residual > 0.5 * start or p.iterations >= p.limit:
                return p.end(Status.STAGNATED, "stagnated")

    def _descend(self, p: LinearSolve, goal: float) -> LinearResult | None:
        """Iterate from the residual in place until it is down to the goal; None unless it fails."""
        space, fall, step, known = self.space, 0.0, 0.0, p.history[-1]
        while p.history[-1] > goal and p.iterations < p.limit:
            z = self._precondition(p)
            new, crossed = (float(product) for product in space.project(self._stack, 2, z))
            keep = -step * crossed / fall if fall else 0.0
            space.axpby(1.0, z, keep, self._direction)
            p.operator(self._direction, self._product)
            across, square, curvature = (
                float(product) for product in space.project(self._stack, 3, self._product)
            )
            if not (math.isfinite(new) and math.isfinite(curvature)):
                return p.end(Status.NAN, "a product or the preconditioner is not finite")
            if new <= 0.0 or curvature <= 0.0:
                culprit = "preconditioner" if new <= 0.0 else "operator"
                return p.end(Status.DIVERGED, f"the {culprit} is not positive")
            fall, step = new, new / curvature
            space.axpy(step, self._direction, p.x)
            space.axpy(-step, self._product, self._residual)
            p.iterations += 1
            rest = p.history[-1] ** 2 - 2.0 * step * across + step**2 * square
            if rest <= (FALL * known) ** 2:  # little is left of what cancels
                known = space.norm(self._residual)
                rest = known**2
            p.history.append(math.sqrt(rest))
        return None

    def _precondition(self, p: LinearSolve) -> wp.array:
        if p.precondition is None:
            return self._residual
        p.precondition(self._residual, self._preconditioned)
        return self._preconditioned

    def _true_residual(self, p: LinearSolve) -> float:
        """Put rhs - A x in place; returns its norm."""
        p.operator(p.x, self._residual)
        self.space.axpby(1.0, p.rhs, -1.0, self._residual)
        return self.space.norm(self._residual)
