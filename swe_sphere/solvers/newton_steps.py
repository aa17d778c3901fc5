"""How exactly the linear systems of Newton iterations are solved, and how long their steps are."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from swe_sphere.errors import ConfigError

Forcing = Callable[[float, float, float | None], float]
"""The relative tolerance eta of the next linear solve, |F + J d| <= eta |F|, from |F|, the norm
that Newton is to reach, and the nonlinearity |F(x + d) - F - J d| / |F|^2 of an earlier step; None
before the first."""

LAST, ALMOST = 0.7, 0.9
"""A step is the last one if it misses less than the former part of what is wanted; it is solved to
the latter part of what that leaves."""
SAFETY = 2.0
LEAST = 1e-6
"""Linear systems are not solved further than that at once, unless that is all that is wanted."""


@dataclass(frozen=True)
class FollowedNonlinearity:
    """As exactly as the linear model agreed with the residual in the step before.

    Choice 1 of Eisenstat & Walker (doi:10.1137/0917003, 1996, eq. 2.2) takes eta from what the
    linear model of the last step missed; here that is carried over to the present |F|, what is
    missed being quadratic.  Where that reaches the target, the system is solved as far as the
    target leaves room; else not further than what will be missed, and no further than half of the
    way (in the logarithm), as two solves of equal depth cost least.

    first: eta while nothing is known.  cap: largest eta, unless half of what is wanted is more; one
    well below the customary 0.9 saves Newton iterations, whose residuals are dear.
    """

    first: float = 0.1
    cap: float = 0.1

    def __post_init__(self) -> None:
        """Raises ConfigError for parameters with which Newton cannot converge."""
        if not all(0.0 < value < 1.0 for value in (self.first, self.cap)):
            raise ConfigError(f"forcing terms need first and cap in (0, 1), not {self}")

    def __call__(self, norm: float, target: float, nonlinearity: float | None) -> float:
        """See `Forcing`."""
        wanted = target / norm
        if nonlinearity is None:
            return max(min(self.first, self.cap), 0.5 * wanted)
        missed = nonlinearity * norm
        if missed < LAST * wanted:
            return ALMOST * math.sqrt(wanted**2 - missed**2)
        eta = max(SAFETY * missed, math.sqrt(wanted), LEAST)
        return max(min(eta, self.cap), 0.5 * wanted)


@dataclass(frozen=True)
class Search:
    """The end of a line search: the last length tried, |F| there, whether it will do, how many."""

    length: float
    norm: float
    success: bool
    trials: int


DECREASE = 1e-4
SHORTEST = 0.1
"""Least part of a trial step that the next one is."""
TRIALS = 11


def backtrack(trial: Callable[[float], float], norm: float, eta: float) -> Search:
    """Shorten until |F(x + s d)| <= (1 - DECREASE s (1 - eta)) |F(x)| (Eisenstat & Walker 1994).

    trial(s) is |F(x + s d)|, norm |F(x)|, eta the forcing term.  The next length is where a
    parabola through |F|^2 has its least value: at first the one with the slope that a direction of
    relative residual eta has at least, then the one through the last two trials and the start
    (Kelley, Iterative Methods for Linear and Nonlinear Equations, 1995, 8.3.1), kept between
    `SHORTEST` and a half of the last.  A trial that is not finite is cut to a quarter.
    """
    length, older = 1.0, (0.0, norm)
    for count in range(1, TRIALS + 1):
        value = trial(length)
        if value <= (1.0 - DECREASE * length * (1.0 - eta)) * norm:
            return Search(length, value, True, count)
        if count < TRIALS:
            newer = (length, value)
            length *= _factor(newer, older, norm, eta)
            older = newer
    return Search(length, value, False, TRIALS)


def _factor(
    newer: tuple[float, float], older: tuple[float, float], norm: float, eta: float
) -> float:
    """By how much to shorten after a trial (length, |F|), given the one before it."""
    (s, value), (t, previous) = newer, older
    if not math.isfinite(value):
        return 0.25
    # |F(s)|^2 = |F(0)|^2 + slope s + curvature s^2
    rise = (value**2 - norm**2) / s
    if t == 0.0 or not math.isfinite(previous):
        slope = -2.0 * (1.0 - eta) * norm**2
        curvature = (rise - slope) / s
    else:
        curvature = (rise - (previous**2 - norm**2) / t) / (s - t)
        slope = rise - curvature * s
    best = -slope / (2.0 * curvature * s) if curvature > 0.0 else 0.5
    return min(max(best, SHORTEST), 0.5)
