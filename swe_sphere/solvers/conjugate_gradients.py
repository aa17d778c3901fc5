"""Conjugate gradients for the symmetric Helmholtz problems of semi-implicit steps.

Flexible: the next direction is found by the formula of Polak and Ribiere, which keeps it conjugate
to the last one whatever the preconditioner does (Golub & Ye 1999, Inexact preconditioned conjugate
gradient method with inner-outer iteration, doi:10.1137/S1064827597323415; Notay 2000,
doi:10.1137/S1064827599362314).  So a preconditioner in float32, or one that is not quite symmetric,
costs an iteration or two and never the answer.
"""

from __future__ import annotations

import math

import warp as wp

from swe_sphere.solvers.linear_result import LinearResult, LinearSolve, Operator, Status
from swe_sphere.solvers.vector_space import VectorSpace

__all__ = ["ConjugateGradients"]

# The residual of the recurrence is not believed below this many round-offs of the terms of the true
# one, and a residual of so few round-offs that no longer falls is as small as it gets.
UNTRUSTED, MOST_ROUNDOFFS = 1e4, 1e3


class ConjugateGradients:
    """Solver of A x = b for A symmetric and positive in the inner product of the space.

    Keep it: it allocates its four or five vectors once.
    """

    def __init__(self, space: VectorSpace) -> None:
        self.space = space
        self._stack = space.stack(2)
        self._residual, self._product = self._stack[0], self._stack[1]
        self._direction, self._preconditioned = space.zeros(), space.zeros()

    def solve(
        self,
        operator: Operator,
        rhs: wp.array,
        x: wp.array,
        precondition: Operator | None = None,
        rtol: float = 1e-6,
        atol: float = 0.0,
        max_iterations: int = 200,
    ) -> LinearResult:
        """Solve operator(x) = rhs (n,) from the guess x, which is replaced by the solution.

        operator(v, out) and precondition(r, out) must not write to their first vector.  Converged
        means |rhs - A x| <= max(rtol |rhs|, atol) [norm of the space]; a tolerance that the
        arithmetic cannot reach, 0 included, is met by a residual of round-off size, and the result
        then says `roundoff`.  Diverged means that the operator or the preconditioner is not
        positive.  Nothing that is not finite is ever added to x.
        """
        scale = self.space.norm(rhs)
        p = LinearSolve(
            operator, precondition, rhs, x, scale, max(rtol * scale, atol), max_iterations
        )
        if scale == 0.0:
            self.space.clear(x)
            p.history.append(0.0)
            return p.end(Status.CONVERGED, "the right-hand side is zero")
        p.history.append(self._true_residual(p) if math.isfinite(scale) else scale)
        if not math.isfinite(p.history[0]):
            return p.end(Status.NOT_A_NUMBER, "the right-hand side or the guess is not finite")
        if p.history[0] <= p.target:
            return p.end(Status.CONVERGED, "the guess is good enough")
        return self._iterate(p)

    def _iterate(self, p: LinearSolve) -> LinearResult:
        """Descents until the target is met or nothing more is to be gained."""
        terms = max(p.scale, p.history[0])
        trusted = p.target >= UNTRUSTED * self.space.epsilon * terms
        while True:
            start = p.history[-1]
            failure = self._descend(p, max(p.target, self.space.epsilon * start))
            if failure is not None:
                return failure
            if p.history[-1] <= p.target and trusted:
                return p.end(Status.CONVERGED, "converged")
            residual = p.history[-1] = self._true_residual(p)
            if residual <= p.target:
                return p.end(Status.CONVERGED, "converged")
            if residual > 0.5 * start and residual <= MOST_ROUNDOFFS * self.space.epsilon * terms:
                return p.end(Status.CONVERGED, "converged to round-off, not to the tolerance", True)
            if residual > 0.5 * start or p.iterations >= p.limit:
                return p.end(Status.STAGNATED, "stagnated")

    def _descend(self, p: LinearSolve, goal: float) -> LinearResult | None:
        """Iterate from the residual in place until it is down to the goal; None unless it fails."""
        space, fall, step = self.space, 0.0, 0.0
        while p.history[-1] > goal and p.iterations < p.limit:
            z = self._precondition(p)
            new, crossed = (float(product) for product in space.project(self._stack, 2, z))
            keep = -step * crossed / fall if fall else 0.0
            space.axpby(1.0, z, keep, self._direction)
            p.operator(self._direction, self._product)
            curvature = space.dot(self._direction, self._product)
            if not (math.isfinite(new) and math.isfinite(curvature)):
                return p.end(Status.NOT_A_NUMBER, "a product or the preconditioner is not finite")
            if new <= 0.0 or curvature <= 0.0:
                culprit = "preconditioner" if new <= 0.0 else "operator"
                return p.end(Status.DIVERGED, f"the {culprit} is not positive")
            fall, step = new, new / curvature
            space.axpy(step, self._direction, p.x)
            space.axpy(-step, self._product, self._residual)
            p.iterations += 1
            p.history.append(space.norm(self._residual))
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
