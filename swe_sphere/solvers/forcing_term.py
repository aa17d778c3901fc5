"""How exactly each linear system of a Newton iteration is solved."""

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
