"""Inexact Newton-Krylov iteration with a line search.

Dembo, Eisenstat & Steihaug (1982), doi:10.1137/0719025; Knoll & Keyes (2004),
doi:10.1016/j.jcp.2003.08.010.
"""

import math
from dataclasses import dataclass, field
from typing import Protocol, Self

import numpy as np
import warp as wp

from swe_sphere.solvers.gmres import FlexibleGMRES
from swe_sphere.solvers.linear_result import Operator, Status
from swe_sphere.solvers.newton_steps import FollowedNonlinearity, Forcing, Search, backtrack
from swe_sphere.solvers.vector_space import VectorSpace

# A correction of so few round-offs of the unknown is one that the unknown cannot resolve.
ROUNDOFFS = 1e3
# What a solve at least makes of the residual of its guess: guesses that are taken as they are, step
# after step, would be an explicit scheme.
LEAST_GAIN = 0.5


class Problem(Protocol):
    """F(x) = 0 for a vector x (n,)."""

    def residual(self, x: wp.array, out: wp.array) -> None:
        """out = F(x)."""
        ...

    def linearise(self, x: wp.array) -> None:
        """Fix the x at which `jacobian` and `precondition` act; x does not change while they do."""
        ...

    def jacobian(self, d: wp.array, out: wp.array) -> None:
        """out = F'(x) d."""
        ...

    @property
    def precondition(self) -> Operator | None:
        """precondition(r, out): out near F'(x)^-1 r; or None."""
        ...


@dataclass
class NewtonResult:
    """A Newton solve, under way and after its end.

    residuals: |F| at the start and after each step taken.  For each iteration the forcing term, the
    Krylov iterations, and the part of the Newton step that was taken, 0 when none was.
    roundoff: converged as far as the arithmetic allows, which missed the tolerance; the status is
    CONVERGED then.
    """

    residuals: list[float]
    target: float = 0.0
    floor: float = 0.0
    forcing: list[float] = field(default_factory=list)
    krylov: list[int] = field(default_factory=list)
    lengths: list[float] = field(default_factory=list)
    status: Status | None = None
    message: str = ""
    roundoff: bool = False

    def end(self, status: Status, message: str, roundoff: bool = False) -> Self:
        """Return this result with its status, and its message completed by counts and residuals."""
        self.status, self.roundoff = status, roundoff
        self.message = (
            f"{message} ({self.newton_iterations} Newton and {self.krylov_iterations} Krylov"
            f" iterations, residual {self.residuals[0]:.1e} to {self.residual:.1e},"
            f" wanted {self.target:.1e})"
        )
        return self

    @property
    def converged(self) -> bool:
        """Whether the status is CONVERGED."""
        return self.status is Status.CONVERGED

    @property
    def residual(self) -> float:
        """The last |F|."""
        return self.residuals[-1]

    @property
    def newton_iterations(self) -> int:
        """Number of Newton iterations."""
        return len(self.krylov)

    @property
    def krylov_iterations(self) -> int:
        """Number of Krylov iterations of all Newton iterations together."""
        return sum(self.krylov)


class NewtonKrylov:
    """Solver of F(x) = 0; keep it: it allocates four vectors, once, and its GMRES the basis."""

    def __init__(
        self,
        space: VectorSpace,
        gmres: FlexibleGMRES,
        rtol: float = 1e-6,
        atol: float = 0.0,
        max_iterations: int = 20,
        max_krylov: int = 200,
        forcing: Forcing | None = None,
    ) -> None:
        """Converged means |F(x)| <= max(rtol |F(x_0)|, atol) in the norm of the space.

        max_krylov: per Newton iteration.  forcing: default FollowedNonlinearity().
        """
        self.space, self.gmres = space, gmres
        self.rtol, self.atol = rtol, atol
        self.max_iterations, self.max_krylov = max_iterations, max_krylov
        self.forcing: Forcing = forcing or FollowedNonlinearity()
        self.nonlinearity: float | None = None
        """Of the last step that told it, see `Forcing`; it is carried over from solve to solve."""
        self._residual, self._trial_residual = space.zeros(), space.zeros()
        self._trial, self._direction = space.zeros(), space.zeros()

    def solve(
        self, problem: Problem, x: wp.array, scale: float | None = None, floor: float = 0.0
    ) -> NewtonResult:
        """Solve from the guess x (n,), which is replaced by the best point found.

        scale: what rtol is relative to instead of |F(x_0)|, so that a better guess saves work; one
        correction is made all the same.  floor: a residual that is worth no second one.  A
        tolerance beyond the arithmetic, 0 included, is met when the corrections are of round-off
        size: the result then says `roundoff`.  Points where F is not finite are stepped back from.
        """
        problem.residual(x, self._residual)
        first = self.space.norm(self._residual)
        p = NewtonResult([first], max(self.rtol * (first if scale is None else scale), self.atol))
        if not math.isfinite(first):
            return p.end(Status.NAN, "the residual of the guess is not finite")
        if first == 0.0 or (scale is None and first <= p.target):
            return p.end(Status.CONVERGED, "the guess is good enough")
        p.target, p.floor = min(max(p.target, floor), LEAST_GAIN * first), floor
        while p.status is None and p.newton_iterations < self.max_iterations:
            self._iterate(p, problem, x)
        return p if p.status else p.end(Status.STAGNATED, "out of Newton iterations")

    def _iterate(self, p: NewtonResult, problem: Problem, x: wp.array) -> None:
        """Take one Newton iteration, which ends the solve if it was the last."""
        norm = p.residual
        eta = self.forcing(norm, p.target, self.nonlinearity)
        problem.linearise(x)
        linear = self.gmres.solve(
            problem.jacobian, self._residual, self._direction, problem.precondition, rtol=eta,
            max_iterations=self.max_krylov, scale=norm, guess=False,
        )  # fmt: skip
        p.forcing.append(eta)
        p.krylov.append(linear.iterations)
        p.lengths.append(0.0)
        if linear.status is Status.NAN:
            p.end(Status.NAN, f"linear solve: {linear.message}")
        elif not linear.residual < 0.999 * norm:
            p.end(Status.STAGNATED, f"no direction from the linear solve: {linear.message}")
        else:
            self._search(p, problem, x, linear.residual / norm)

    def _search(self, p: NewtonResult, problem: Problem, x: wp.array, eta: float) -> None:
        """Move along J d = F, solved to a relative residual eta, and judge where that leads."""

        def trial(length: float) -> float:
            """Return |F| at x - length d, and leave point and residual in the trial vectors."""
            self.space.copy(x, self._trial)
            self.space.axpy(-length, self._direction, self._trial)
            problem.residual(self._trial, self._trial_residual)
            return self.space.norm(self._trial_residual)

        tiny = eta < 0.5 and self._is_roundoff(x)
        search = Search(1.0, trial(1.0), True, 1) if tiny else backtrack(trial, p.residual, eta)
        if not tiny:
            self._learn(p, search, eta)
        self._accept(p, x, search, eta, tiny)

    def _is_roundoff(self, x: wp.array) -> bool:
        """Whether the correction is too small for x to resolve."""
        d = self._direction
        correction, size = np.sqrt(self.space.dots((d, d), (x, x)))
        return bool(correction <= ROUNDOFFS * self.space.epsilon * size)

    def _learn(self, p: NewtonResult, search: Search, eta: float) -> None:
        """Take the nonlinearity from a step, for parts at right angles in the residual it left.

        Later steps of a solve tell it only where they left more than the linear system did.
        """
        norm, length = p.residual, search.length
        expected = (1.0 - length * (1.0 - eta)) * norm
        missed = math.sqrt(max(search.norm**2 - expected**2, 0.0))
        if math.isfinite(missed) and (len(p.krylov) == 1 or missed > expected):
            self.nonlinearity = missed / (length * norm) ** 2

    def _accept(self, p: NewtonResult, x: wp.array, search: Search, eta: float, tiny: bool) -> None:
        """Move to the point found if it is better, and end the solve there if it is the last."""
        norm = p.residual
        if not math.isfinite(search.norm):
            p.end(Status.NAN, "the residual is not finite along the Newton direction")
            return
        if search.success and (search.norm < norm or not tiny):
            self.space.copy(self._trial, x)
            self._residual, self._trial_residual = self._trial_residual, self._residual
            p.residuals.append(search.norm)
            p.lengths[-1] = search.length
            if search.norm <= max(p.target, p.floor):
                p.end(Status.CONVERGED, "converged")
                return
        if tiny and search.norm > 0.5 * (1.0 + eta) * norm:
            p.end(Status.CONVERGED, "converged to round-off, not to the tolerance", True)
        elif not search.success:
            p.end(Status.STAGNATED, f"no decrease after {search.trials} trial steps")
