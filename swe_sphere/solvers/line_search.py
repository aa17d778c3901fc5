"""Step lengths for Newton directions that are too long."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from swe_sphere.errors import ConfigError


@dataclass(frozen=True)
class Search:
    """The end of a line search: the last length tried, |F| there, whether it will do, how many."""

    length: float
    norm: float
    success: bool
    trials: int


@dataclass(frozen=True)
class Backtracking:
    """Shorten until |F(x + s d)| <= (1 - decrease s (1 - eta)) |F(x)| (Eisenstat & Walker 1994).

    The next length is where a parabola through |F|^2 has its least value: at first the one with the
    slope that a direction of relative residual eta has at least, then the one through the last two
    trials and the start (Kelley, Iterative Methods for Linear and Nonlinear Equations, 1995,
    8.3.1), kept between `shortest` and a half of the last.  A trial that is not finite is cut to a
    quarter.  shortenings: how often to shorten; 0 takes every finite full step, whatever it does.
    """

    decrease: float = 1e-4
    shortest: float = 0.1
    shortenings: int = 10

    def __post_init__(self) -> None:
        """Raises ConfigError for numbers with which no step could be accepted."""
        lengths = 0.0 <= self.decrease < 0.5 and 0.0 < self.shortest <= 0.5
        if not lengths or self.shortenings < 0:
            raise ConfigError(
                "a line search needs decrease in [0, 0.5), shortest in (0, 0.5], shortenings >= 0"
            )

    def __call__(self, trial: Callable[[float], float], norm: float, eta: float) -> Search:
        """Search along a direction: trial(s) is |F(x + s d)|, norm |F(x)|, eta the forcing term."""
        length, older = 1.0, (0.0, norm)
        for count in range(self.shortenings + 1):
            value = trial(length)
            if self.accepts(length, value, norm, eta):
                return Search(length, value, True, count + 1)
            if count < self.shortenings:
                newer = (length, value)
                length *= self._factor(newer, older, norm, eta)
                older = newer
        return Search(length, value, False, self.shortenings + 1)

    def accepts(self, length: float, value: float, norm: float, eta: float) -> bool:
        """Whether a trial is good enough."""
        if self.shortenings == 0:
            return math.isfinite(value)
        return value <= (1.0 - self.decrease * length * (1.0 - eta)) * norm

    def _factor(
        self, newer: tuple[float, float], older: tuple[float, float], norm: float, eta: float
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
        return min(max(best, self.shortest), 0.5)
