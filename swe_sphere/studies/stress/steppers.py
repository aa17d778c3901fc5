"""The steppers by what limits their steps."""

from __future__ import annotations

from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.stepper import Family

__all__ = ["EXPLICIT", "IMPLICIT", "SPLIT"]


def _of(family: Family) -> tuple[str, ...]:
    return tuple(name for name, kind in STEPPERS.items() if kind.family == family)


EXPLICIT, SPLIT, IMPLICIT = _of("explicit"), _of("imex"), _of("implicit")
