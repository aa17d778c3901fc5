"""Inexact Newton-Krylov iteration with a line search.

Dembo, Eisenstat & Steihaug (1982), doi:10.1137/0719025; Knoll & Keyes (2004),
doi:10.1016/j.jcp.2003.08.010.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import warp as wp

from swe_sphere.solvers.gmres import FlexibleGMRES
from swe_sphere.solvers.linear_result import LinearResult, Operator, Status
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


@dataclass(frozen=True)
class NewtonHistory:
    """What happened, iteration by iteration.

    residuals: |F| at the start and after each step taken.  For each iteration the forcing term, the
    Krylov iterations, and the part of the Newton step that was taken, 0 when none was.
    """

    residuals: tuple[float, ...]
    forcing: tuple[float, ...]
    krylov: tuple[int, ...]
    lengths: tuple[float, ...]


@dataclass(frozen=True)
class NewtonResult:
    """The end of a Newton solve.

    roundoff: converged as far as the arithmetic allows, which missed the tolerance; the status is
    CONVERGED then.  residual_evaluations: calls of F alone, without Jacobian products.
    """

    status: Status
    newton_iterations: int
    krylov_iterations: int
    history: NewtonHistory
    message: str
    residual_evaluations: int = 0
    roundoff: bool = False

    @property
    def converged(self) -> bool:
        """Whether the status is CONVERGED."""
        return self.status is Status.CONVERGED

    @property
    def residual(self) -> float:
        """The last |F|."""
        return self.history.residuals[-1]


@dataclass
class _Progress:
    """One solve under way."""

    problem: Problem
    x: wp.array
    target: float = 0.0
    floor: float = 0.0
    residuals: list[float] = field(default_factory=list)
    forcing: list[float] = field(default_factory=list)
    krylov: list[int] = field(default_factory=list)
    lengths: list[float] = field(default_factory=list)
    evaluations: int = 0

    def end(self, status: Status, message: str, roundoff: bool = False) -> NewtonResult:
        """The result, with the message completed by counts and residuals."""
        history = NewtonHistory(
            tuple(self.residuals), tuple(self.forcing), tuple(self.krylov), tuple(self.lengths)
        )
        newton, krylov = len(self.krylov), sum(self.krylov)
        line = (
            f"{message} ({newton} Newton and {krylov} Krylov iterations, residual "
            f"{self.residuals[0]:.1e} to {self.residuals[-1]:.1e}, wanted {self.target:.1e})"
        )
        return NewtonResult(status, newton, krylov, history, line, self.evaluations, roundoff)


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
        p = _Progress(problem, x, residuals=[first], evaluations=1)
        p.target = max(self.rtol * (first if scale is None else scale), self.atol)
        if not math.isfinite(first):
            return p.end(Status.NAN, "the residual of the guess is not finite")
        if first == 0.0 or (scale is None and first <= p.target):
            return p.end(Status.CONVERGED, "the guess is good enough")
        p.target, p.floor = min(max(p.target, floor), LEAST_GAIN * first), floor
        while len(p.krylov) < self.max_iterations:
            result = self._iterate(p)
            if result is not None:
                return result
        return p.end(Status.STAGNATED, "out of Newton iterations")

    def _iterate(self, p: _Progress) -> NewtonResult | None:
        """One Newton iteration; a result when it was the last."""
        linear = self._solve_linear(p)
        if linear.status is Status.NAN:
            return p.end(Status.NAN, f"linear solve: {linear.message}")
        if not linear.residual < 0.999 * p.residuals[-1]:
            return p.end(Status.STAGNATED, f"no direction from the linear solve: {linear.message}")
        norm = p.residuals[-1]
        eta = linear.residual / norm
        tiny = eta < 0.5 and self._is_roundoff(p.x)
        trial = self._trial_along(p)
        search = Search(1.0, trial(1.0), True, 1) if tiny else backtrack(trial, norm, eta)
        p.evaluations += search.trials
        if not tiny:
            self._learn(p, search, eta)
        return self._accept(p, search, eta, tiny)

    def _solve_linear(self, p: _Progress) -> LinearResult:
        """Put the negative Newton direction, J d = F, in self._direction."""
        eta = self.forcing(p.residuals[-1], p.target, self.nonlinearity)
        p.problem.linearise(p.x)
        linear = self.gmres.solve(
            p.problem.jacobian,
            self._residual,
            self._direction,
            p.problem.precondition,
            rtol=eta,
            max_iterations=self.max_krylov,
            scale=p.residuals[-1],
            guess=False,
        )
        p.forcing.append(eta)
        p.krylov.append(linear.iterations)
        p.lengths.append(0.0)
        return linear

    def _is_roundoff(self, x: wp.array) -> bool:
        """Whether the correction is too small for x to resolve."""
        d = self._direction
        correction, size = np.sqrt(self.space.dots((d, d), (x, x)))
        return bool(correction <= ROUNDOFFS * self.space.epsilon * size)

    def _trial_along(self, p: _Progress) -> Callable[[float], float]:
        """|F| at x - s d, with point and residual left in the trial vectors."""

        def trial(length: float) -> float:
            self.space.copy(p.x, self._trial)
            self.space.axpy(-length, self._direction, self._trial)
            p.problem.residual(self._trial, self._trial_residual)
            return self.space.norm(self._trial_residual)

        return trial

    def _learn(self, p: _Progress, search: Search, eta: float) -> None:
        """Take the nonlinearity from a step, for parts at right angles in the residual it left.

        Later steps of a solve tell it only where they left more than the linear system did.
        """
        norm, length = p.residuals[-1], search.length
        expected = (1.0 - length * (1.0 - eta)) * norm
        missed = math.sqrt(max(search.norm**2 - expected**2, 0.0))
        if math.isfinite(missed) and (len(p.krylov) == 1 or missed > expected):
            self.nonlinearity = missed / (length * norm) ** 2

    def _accept(self, p: _Progress, search: Search, eta: float, tiny: bool) -> NewtonResult | None:
        """Move to the point found, if it is better, and judge where that leads."""
        norm = p.residuals[-1]
        if not math.isfinite(search.norm):
            return p.end(Status.NAN, "the residual is not finite along the Newton direction")
        if search.success and (search.norm < norm or not tiny):
            self.space.copy(self._trial, p.x)
            self._residual, self._trial_residual = self._trial_residual, self._residual
            p.residuals.append(search.norm)
            p.lengths[-1] = search.length
            if search.norm <= max(p.target, p.floor):
                return p.end(Status.CONVERGED, "converged")
        if tiny and search.norm > 0.5 * (1.0 + eta) * norm:
            return p.end(Status.CONVERGED, "converged to round-off, not to the tolerance", True)
        if not search.success:
            return p.end(Status.STAGNATED, f"no decrease after {search.trials} trial steps")
        return None
