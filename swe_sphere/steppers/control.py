"""The rule by which adaptive steps are made longer, shorter, or taken again."""

import math
from dataclasses import dataclass

from swe_sphere.errors import ConfigError

SAFETY = 0.9
PRESENT, PAST = 0.7, 0.4
"""Exponents of the present error and of the one before, times the order."""
LEAST, MOST = 0.5, 2.0
"""Bounds of the ratio of two successive steps."""


@dataclass(frozen=True)
class PIController:
    """Proportional-integral control of the step by an estimate of its error.

    dt_new = dt 0.9 (tolerance/error)^(0.7/p) (error_before/tolerance)^(0.4/p), between dt/2 and
    2 dt (Gustafsson 1991, doi:10.1145/210232.210242; Hairer & Wanner 1996, IV.2).  It has no
    memory: who steps keeps the error before.  `tolerance` in the unit of the errors; `order` p: the
    power of dt that the error goes with.  Raises ConfigError for values out of range.
    """

    tolerance: float
    order: int

    def __post_init__(self) -> None:
        if not (math.isfinite(self.tolerance) and self.tolerance > 0.0):
            raise ConfigError(
                f"adaptive: the tolerance must be positive and finite, not {self.tolerance}"
            )
        if self.order < 1:
            raise ConfigError(f"adaptive: the order must be at least 1, not {self.order}")

    def accepts(self, error: float) -> bool:
        """Whether a step with that error may stand; one that is NaN may not."""
        return error <= self.tolerance

    def ratio(self, error: float, before: float) -> float:
        """Length of the next step over that of this one, from its error and the one before."""
        if not math.isfinite(error):
            return LEAST
        if error == 0.0:
            return MOST
        present: float = (self.tolerance / error) ** (PRESENT / self.order)
        past: float = (before / self.tolerance) ** (PAST / self.order)
        return min(MOST, max(LEAST, SAFETY * present * past))
