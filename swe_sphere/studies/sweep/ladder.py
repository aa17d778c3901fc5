"""Which steps to try where the user names none."""

from __future__ import annotations

import math

__all__ = ["downwards", "ladder", "upwards"]

RATIO = math.sqrt(2.0)
"""Between the steps of an explicit stepper, whose useful range is short."""
FARTHEST = 64.0
"""The longest implicit step, in gravity limits: what studies found useful, and a little more."""
SHORTEST = 2.0
"""The shortest one; below, an explicit stepper does the same for a fraction of the time."""


def ladder(
    usable: float, explicit: bool, gravity: float, longest: float, levels: int
) -> list[float]:
    """Steps [s] for a stepper, the longest first.

    usable: safe part of the stability limit [s], infinite where there is none; explicit: whether
    gravity waves set that limit; gravity: limit [s] of leapfrog; longest: no step is longer [s];
    levels: how many steps.
    """
    top = min(usable, FARTHEST * gravity, longest)
    if explicit:
        return downwards(top, levels)
    bottom = gravity if math.isfinite(usable) else SHORTEST * gravity
    return upwards(min(bottom, top), top, levels)


def downwards(top: float, levels: int) -> list[float]:
    """From the limit down by factors of `RATIO`."""
    return [top / RATIO**n for n in range(levels)]


def upwards(bottom: float, top: float, levels: int) -> list[float]:
    """Up from a shortest to the longest step in equal ratios; the longest first."""
    if levels == 1 or top <= bottom * (1.0 + 1e-9):
        return [top]
    ratio = (top / bottom) ** (1.0 / (levels - 1))
    return [top / ratio**n for n in range(levels)]
