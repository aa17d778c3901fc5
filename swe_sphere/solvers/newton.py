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
from swe_sphere.solvers.krylov import Operator, SolveResult, Status
from swe_sphere.solvers.vector_space import VectorSpace

# A correction of so few round-offs of the unknown is one that the unknown cannot resolve.
ROUNDOFFS = 1e3
# What a solve at least makes of the residual of its guess: guesses that are taken as they are, step
# after step, would be an explicit scheme.
LEAST_GAIN = 0.5

LAST, ALMOST = 0.7, 0.9
"""A step is the last one if it misses less than the former part of what is wanted; it is solved to
the latter part of what that leaves."""
SAFETY = 2.0
LEAST = 1e-6
"""Linear systems are not solved further than that at once, unless that is all that is wanted."""

DECREASE = 1e-4
SHORTEST = 0.1
"""Least part of a trial step that the next one is."""
TRIALS = 11

Forcing = Callable[[float, float, float | None], float]
"""The relative tolerance eta of the next linear solve, |F + J d| <= eta |F|, from |F|, the norm
that Newton is to reach, and the nonlinearity |F(x + d) - F - J d| / |F|^2 of an earlier step; None
before the first."""


FIRST = 0.02
"""The forcing term while nothing is known."""
CAP = 0.1
"""Largest forcing term, unless half of what is wanted is more.  One well below the customary 0.9
saves Newton iterations, whose residuals are expensive."""


def followed_nonlinearity(norm: float, target: float, nonlinearity: float | None) -> float:
    """Return the `Forcing` that is as exact as the linear model was in the step before.

    Choice 1 of Eisenstat & Walker (doi:10.1137/0917003, 1996, eq. 2.2) takes eta from what the
    linear model of the last step missed; here that is carried over to the present |F|, what is
    missed being quadratic.  Where that reaches the target, the system is solved as far as the
    target leaves room; else not further than what will be missed, and no further than half of the
    way (in the logarithm), as two solves of equal depth cost least.
    """
    wanted = target / norm
    if nonlinearity is None:
        return max(FIRST, 0.5 * wanted)
    missed = nonlinearity * norm
    if missed < LAST * wanted:
        return ALMOST * math.sqrt(wanted**2 - missed**2)
    eta = max(SAFETY * missed, math.sqrt(wanted), LEAST)
    return max(min(eta, CAP), 0.5 * wanted)


class Problem(Protocol):
    """F(x) = 0 for a vector x (n,)."""

    def residual(self, x: wp.array, out: wp.array) -> None:
        """out = F(x)."""

    def linearise(self, x: wp.array) -> None:
        """Fix the x at which `jacobian` and `precondition` act; x does not change while they do."""

    def jacobian(self, d: wp.array, out: wp.array) -> None:
        """out = F'(x) d."""

    @property
    def precondition(self) -> Operator | None:
        """precondition(r, out): out near F'(x)^-1 r; or None."""


@dataclass(kw_only=True)
class NewtonResult(SolveResult):
    """A Newton solve: for each iteration the forcing term, the Krylov iterations, and the part of
    the Newton step that was taken, 0 when none was.

    floor: a residual that is worth no further iteration.
    """

    floor: float
    forcing: list[float] = field(default_factory=list)
    krylov: list[int] = field(default_factory=list)
    lengths: list[float] = field(default_factory=list)

    @property
    def counts(self) -> str:
        """Iterations and residuals."""
        return (
            f"{self.newton_iterations} Newton and {self.krylov_iterations} Krylov iterations,"
            f" residual {self.history[0]:.1e} to {self.residual:.1e}, wanted {self.target:.1e}"
        )

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
        self, space: VectorSpace, gmres: FlexibleGMRES, rtol: float = 1e-6, atol: float = 0.0,
        max_iterations: int = 20, max_krylov: int = 200, forcing: Forcing = followed_nonlinearity,
    ) -> None:  # fmt: skip
        """Converged means |F(x)| <= max(rtol |F(x_0)|, atol) in the norm of the space.

        max_krylov: per Newton iteration.
        """
        self.space, self.gmres = space, gmres
        self.rtol, self.atol = rtol, atol
        self.max_iterations, self.max_krylov = max_iterations, max_krylov
        self.forcing = forcing
        self.nonlinearity: float | None = None
        """Last measured nonlinearity, see `Forcing`; it is kept from solve to solve."""
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
        target = max(self.rtol * (first if scale is None else scale), self.atol)
        p = NewtonResult(history=[first], target=target, floor=floor)
        if not math.isfinite(first):
            return p.end(Status.NAN, "the residual of the guess is not finite")
        if first == 0.0 or (scale is None and first <= p.target):
            return p.end(Status.CONVERGED, "the guess is good enough")
        p.target = min(max(p.target, floor), LEAST_GAIN * first)
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
            return
        if not linear.residual < 0.999 * norm:
            p.end(Status.STAGNATED, f"no direction from the linear solve: {linear.message}")
            return

        def trial(length: float) -> float:
            """Return |F| at x - length d, and leave point and residual in the trial vectors."""
            self.space.axpby(-length, self._direction, 1.0, x, self._trial)
            problem.residual(self._trial, self._trial_residual)
            return self.space.norm(self._trial_residual)

        eta, d, tiny = linear.residual / norm, self._direction, False
        if eta < 0.5:
            correction, size = np.sqrt(self.space.dots((d, d), (x, x)))
            tiny = bool(correction <= ROUNDOFFS * self.space.epsilon * size)
        search = Search(1.0, trial(1.0), True, 1) if tiny else backtrack(trial, norm, eta)
        if not tiny:
            self._learn(p, search, eta)
        self._accept(p, x, search, eta, tiny)

    def _learn(self, p: NewtonResult, search: "Search", eta: float) -> None:
        """Take the nonlinearity from a step, for parts at right angles in the residual it left.

        Later steps of a solve tell it only where they left more than the linear system did.
        """
        norm, length = p.residual, search.length
        expected = (1.0 - length * (1.0 - eta)) * norm
        missed = math.sqrt(max(search.norm**2 - expected**2, 0.0))
        if math.isfinite(missed) and (len(p.krylov) == 1 or missed > expected):
            self.nonlinearity = missed / (length * norm) ** 2

    def _accept(
        self, p: NewtonResult, x: wp.array, search: "Search", eta: float, tiny: bool
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
            p.lengths[-1] = search.length
            if search.norm <= max(p.target, p.floor):
                p.end(Status.CONVERGED, "converged")
                return
        if tiny and search.norm > 0.5 * (1.0 + eta) * norm:
            p.end(Status.CONVERGED, "converged to round-off, not to the tolerance", True)
        elif not search.success:
            p.end(Status.STAGNATED, f"no decrease after {search.trials} trial steps")


@dataclass(frozen=True)
class Search:
    """The end of a line search: the last length tried, |F| there, whether it will do, how many."""

    length: float
    norm: float
    success: bool
    trials: int


def backtrack(trial: Callable[[float], float], norm: float, eta: float) -> Search:
    """Shorten until |F(x + s d)| <= (1 - DECREASE s (1 - eta)) |F(x)| (Eisenstat & Walker 1994).

    trial(s) is |F(x + s d)|, norm |F(x)|, eta the forcing term.  The next length is where a
    parabola through |F|^2 has its least value: at first the one with the slope that a direction of
    relative residual eta has at least, then the one through the last two trials and the start
    (Kelley, Iterative Methods for Linear and Nonlinear Equations, 1995, 8.3.1), kept between
    `SHORTEST` and a half of the last.  A trial that is not finite is cut to a quarter.
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
            factor = min(max(best, SHORTEST), 0.5)
        s, t, previous = s * factor, s, value
    return Search(s, value, False, TRIALS)
