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

from swe_sphere.solvers.linear_result import KrylovSolver, LinearResult, Status
from swe_sphere.solvers.vector_space import VectorSpace

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

    def _cycle(self, p: LinearResult) -> None:
        """Descend to the target, and judge by the true residual where it may be another one."""
        start = p.residual
        self._descend(p, max(p.target, self.space.epsilon * p.terms))
        if p.status is None:
            self._judge(p, 0.5 * start)

    def _descend(self, p: LinearResult, goal: float) -> None:
        """Iterate from the residual in place until it is down to the goal, or fails.

        Products are named by their vectors: r the residual, z = M r, w = A z, d the last direction
        and s = A d.
        """
        space, r, s, w, curvature = self.space, self._residual, self._product, self._image, 0.0
        space.clear(self._direction)
        space.clear(s)
        while p.residual > goal and p.iterations < p.limit:
            z = r if p.precondition is None else self._preconditioned
            if p.precondition is not None:
                p.precondition(r, z)
            p.operator(z, w)
            stack = self._stack
            found = space.projections((stack, 3, z), (stack, 3, w), (stack, 2, r), (stack, 1, s))
            sz, rz, wz, sw, rw, ww, sr, rr, ss = map(float, found)
            # how much of d to add to z, to be conjugate to d, and <., A .> of that
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
            if rest <= FALL**2 * rr:  # little is left of what cancels
                rest = space.dot(r, r)
            p.history.append(math.sqrt(rest))
