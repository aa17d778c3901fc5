"""Inexact Newton-Krylov iteration with a line search.

Dembo et al. (1982), doi:10.1137/0719025; Knoll & Keyes (2004), doi:10.1016/j.jcp.2003.08.010.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
import warp as wp

from swe_sphere.equations.right_hand_side import Operator
from swe_sphere.solvers.krylov import FlexibleGMRES, SolveResult, Status
from swe_sphere.solvers.vector_space import VectorSpace

ROUNDOFFS = 1e3
"""Number of round-offs below which corrections and residuals of linear solves are not resolved."""
LEAST_GAIN = 0.5
"""Least reduction of the guess's residual; accepting every guess would be an explicit scheme."""

LAST_STEP, MARGIN = 0.7, 0.9
"""A step is the last one if its estimated error is below the first fraction of the target; the
linear solve then uses the second fraction of the remaining tolerance."""
SAFETY = 2.0
"""Ratio of the forcing term to the extrapolated error of the linear model."""
LEAST = 1e-6
"""Least relative tolerance of a linear solve, unless the target itself is smaller."""

DECREASE = 1e-4
"""Fraction of the decrease by the linear model that a trial step must reach."""
LEAST_SHORTENING = 0.1
"""Least ratio of a trial step to the one before."""
TRIALS = 11
"""Largest number of trial steps of a line search."""

FIRST = 0.02
"""Forcing term of the first step, before any estimate."""
CAP = 0.1
"""Largest forcing term before the last step, unless half of the target is more.  A value well below
the customary 0.9 saves Newton iterations, whose residuals are expensive."""


def forcing_term(norm: float, target: float, nonlinearity: float | None) -> float:
    """Return the forcing term eta, from the error of the linear model in an earlier step.

    The solve ends at |F - J d| <= eta |F|. norm: |F|; target: largest |F| at the end; nonlinearity:
    |F(x - d) - F + J d| / |F|^2 of an earlier step, None before the first.

    Choice 1 of Eisenstat & Walker (doi:10.1137/0917003, 1996, eq. 2.2) derives eta from the error
    of the last linear model. Here this error, which is quadratic, is extrapolated to the present
    |F|. If it is below the target, eta is as large as reaching the target permits; otherwise eta is
    twice the error, or half of the way to the target on a log scale: two equal solves cost least.
    """
    wanted = target / norm
    if nonlinearity is None:
        return max(FIRST, 0.5 * wanted)
    missed = nonlinearity * norm
    if missed < LAST_STEP * wanted:
        return MARGIN * math.sqrt(wanted**2 - missed**2)
    eta = max(SAFETY * missed, math.sqrt(wanted), LEAST)
    return max(min(eta, CAP), 0.5 * wanted)


class Problem(Protocol):
    """The problem F(x) = 0 for a vector x (n,)."""

    def residual(self, x: wp.array, out: wp.array) -> None:
        """Set out = F(x)."""

    def linearise(self, x: wp.array) -> None:
        """Fix the x at which `jacobian` acts; `precondition` may be that of an earlier x."""

    def jacobian(self, d: wp.array, out: wp.array) -> None:
        """Set out = F'(x) d."""

    @property
    def precondition(self) -> Operator | None:
        """Return a function (r, out) that sets out to about F'(x)^-1 r, or None."""


@dataclass(kw_only=True)
class NewtonResult(SolveResult):
    """A Newton solve.  floor: a residual below which no further iteration pays."""

    floor: float
    newton_iterations: int = 0
    krylov_iterations: int = 0

    @property
    def counts(self) -> str:
        return (
            f"{self.newton_iterations} Newton and {self.krylov_iterations} Krylov iterations,"
            f" residual {self.history[0]:.1e} to {self.residual:.1e}, wanted {self.target:.1e}"
        )


class NewtonKrylov:
    """Solver of F(x) = 0; keep the instance, as it allocates only once.

    The space of `gmres`, which solves the linear systems, may be of float32: later iterations
    correct the error, because they start from residuals in the number type of `space`.
    """

    def __init__(
        self, space: VectorSpace, gmres: FlexibleGMRES, max_iterations: int = 20,
        max_krylov: int = 200,
        forcing: Callable[[float, float, float | None], float] = forcing_term,
    ) -> None:  # fmt: skip
        """Allocate; max_krylov: largest number of Krylov iterations per Newton iteration."""
        self.space, self.gmres, self.forcing = space, gmres, forcing
        self.max_iterations, self.max_krylov = max_iterations, max_krylov
        self.nonlinearity: float | None = None
        """Last measured nonlinearity, kept from solve to solve; see `forcing_term`."""
        self._residual, self._trial_residual = space.zeros(), space.zeros()
        self._trial, self._solution = space.zeros(), gmres.space.zeros()

    def solve(
        self, problem: Problem, x: wp.array, rtol: float = 1e-6, scale: float | None = None,
        floor: float = 0.0,
    ) -> NewtonResult:  # fmt: skip
        """Solve from the guess x (n,), which is replaced by the best point found.

        Converged means |F(x)| <= max(rtol |F(x_0)|, floor) in the norm of the space; a guess that
        meets this is still corrected, to half of its residual or to the floor. scale: in place of
        |F(x_0)|, so that a better guess saves work. floor: a residual below which no further
        correction pays. A tolerance below the accuracy of the arithmetic, even 0, is met by changes
        of round-off size: the result then sets `roundoff`. Steps are shortened if F is not finite.
        """
        problem.residual(x, self._residual)
        first = self.space.norm(self._residual)
        target = rtol * (first if scale is None else scale)
        p = NewtonResult(history=[first], target=target, floor=floor)
        if not math.isfinite(first):
            return p.end(Status.NAN, "the residual of the guess is not finite")
        if first == 0.0:
            return p.end(Status.CONVERGED, "the guess is good enough")
        p.target = min(max(p.target, floor), LEAST_GAIN * first)
        while p.status is None and p.newton_iterations < self.max_iterations:
            self._iterate(p, problem, x)
        return p if p.status else p.end(Status.STAGNATED, "out of Newton iterations")

    def _iterate(self, p: NewtonResult, problem: Problem, x: wp.array) -> None:
        """Take one Newton iteration, which ends the solve if it is the last."""
        norm, space = p.residual, self.gmres.space
        eta = self.forcing(norm, p.target, self.nonlinearity)
        problem.linearise(x)
        linear = self.gmres.solve(
            problem.jacobian, space.converted(self._residual), self._solution,
            problem.precondition, rtol=max(eta, ROUNDOFFS * space.epsilon),
            max_iterations=self.max_krylov, scale=norm, guess=False,
        )  # fmt: skip
        d = self.space.converted(self._solution)
        p.newton_iterations += 1
        p.krylov_iterations += linear.iterations
        if linear.status is Status.NAN:
            p.end(Status.NAN, f"linear solve: {linear.message}")
            return
        if not linear.residual < 0.999 * norm:
            p.end(Status.STAGNATED, f"no direction from the linear solve: {linear.message}")
            return

        def trial(length: float) -> float:
            """Return |F| at x - length d, and store point and residual in the trial vectors."""
            self.space.axpby(-length, d, 1.0, x, self._trial)
            problem.residual(self._trial, self._trial_residual)
            return self.space.norm(self._trial_residual)

        reached, tiny = linear.residual / norm, False
        if reached < 0.5:
            correction, size = np.sqrt(self.space.dots((d, d), (x, x)))
            tiny = bool(correction <= ROUNDOFFS * self.space.epsilon * size)
        search = Search(1.0, trial(1.0), True, 1) if tiny else backtrack(trial, norm, reached)
        if not tiny:
            self._learn(p, search, reached)
        self._accept(p, x, search, reached, tiny)

    def _learn(self, p: NewtonResult, search: "Search", reached: float) -> None:
        """Estimate the nonlinearity from a step, as if the parts of its residual were orthogonal.

        Later steps of a solve contribute only if the part of their residual that the linear model
        missed exceeds the part that it predicts. reached: relative residual of the linear solve.
        """
        norm, length = p.residual, search.length
        expected = (1.0 - length * (1.0 - reached)) * norm
        missed = math.sqrt(max(search.norm**2 - expected**2, 0.0))
        if math.isfinite(missed) and (p.newton_iterations == 1 or missed > expected):
            self.nonlinearity = missed / (length * norm) ** 2

    def _accept(
        self, p: NewtonResult, x: wp.array, search: "Search", reached: float, tiny: bool
    ) -> None:
        """Move to the point found if it is better, and end the solve there if it is the last."""
        norm = p.residual
        if not math.isfinite(search.norm):
            p.end(Status.NAN, "the residual is not finite along the Newton direction")
            return
        if search.success and (search.norm < norm or not tiny):
            self.space.copy(self._trial, x)
            self._residual, self._trial_residual = self._trial_residual, self._residual
            p.history.append(search.norm)
            if search.norm <= max(p.target, p.floor):
                p.end(Status.CONVERGED, "converged")
                return
        if tiny and search.norm > 0.5 * (1.0 + reached) * norm:
            p.end(Status.CONVERGED, "converged to round-off, not to the tolerance", True)
        elif not search.success:
            p.end(Status.STAGNATED, f"no decrease after {search.trials} trial steps")


class Search(NamedTuple):
    """The end of a line search: the last length tried, |F| there, acceptance, number of trials."""

    length: float
    norm: float
    success: bool
    trials: int


def backtrack(trial: Callable[[float], float], norm: float, eta: float) -> Search:
    """Shorten until |F(x - s d)| <= (1 - DECREASE s (1 - eta)) |F(x)| (Eisenstat & Walker 1994).

    trial(s) is |F(x - s d)|, norm |F(x)|, eta the relative residual of d in the linear system. The
    next length minimises a parabola through |F|^2: at first that of the gentlest slope of d, then
    the one through the last two trials and the origin (Kelley, Iterative Methods for
    Linear and Nonlinear Equations, 1995, 8.3.1), limited to between `LEAST_SHORTENING` and a half
    of the last. A trial that is not finite is cut to a quarter.
    """
    s, t, previous = 1.0, 0.0, norm
    for count in range(1, TRIALS + 1):
        value = trial(s)
        if value <= (1.0 - DECREASE * s * (1.0 - eta)) * norm:
            return Search(s, value, True, count)
        if count == TRIALS:
            break
        factor = 0.25
        if math.isfinite(value):
            # |F(s)|^2 = |F(0)|^2 + slope s + curvature s^2
            rise = (value**2 - norm**2) / s
            if t == 0.0 or not math.isfinite(previous):
                slope = -2.0 * (1.0 - eta) * norm**2
                curvature = (rise - slope) / s
            else:
                curvature = (rise - (previous**2 - norm**2) / t) / (s - t)
                slope = rise - curvature * s
            best = -slope / (2.0 * curvature * s) if curvature > 0.0 else 0.5
            factor = min(max(best, LEAST_SHORTENING), 0.5)
        s, t, previous = s * factor, s, value
    return Search(s, value, False, TRIALS)
