"""Which steps to take: sequences, and searches for the longest that works or is accurate."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

RATIO = math.sqrt(2.0)
"""Between the steps of an explicit stepper, whose useful range is short."""
FARTHEST = 64.0
"""The longest implicit step, in gravity limits: what studies found useful, and a little more."""
SHORTEST = 2.0
"""The shortest one; below, an explicit stepper does the same for a fraction of the time."""

GROWTH = 1.25
"""Between steps while the limit is not yet enclosed."""
REFINEMENTS = 6
LIMIT_KNOWN, ACCURATE_KNOWN = 0.02, 0.05
"""How closely searches find the longest step that works, or is accurate; relative."""
PLATEAU = 0.9
"""An error that a halved step leaves above this part of itself does not depend on the step."""


def dt_sequence(
    usable: float, explicit: bool, gravity: float, longest: float, levels: int
) -> list[float]:
    """Steps [s] for a stepper, the longest first, where the user names none.

    usable: safe part of the stability limit [s], infinite where there is none; explicit: whether
    gravity waves set that limit; gravity: limit [s] of leapfrog; longest: no step is longer [s];
    levels: how many steps.
    """
    top = min(usable, FARTHEST * gravity, longest)
    bottom = min(gravity if math.isfinite(usable) else SHORTEST * gravity, top)
    if explicit:
        ratio = RATIO
    elif levels == 1 or top <= bottom * (1.0 + 1e-9):
        return [top]
    else:
        ratio = float((top / bottom) ** (1.0 / (levels - 1)))
    return [top / ratio**n for n in range(levels)]


def halved(longest: float, shortest: float, levels: int) -> list[float]:
    """Steps [s] from the longest down by halves, so many at the most, none below the shortest."""
    steps = [longest / 2**n for n in range(levels)]
    return [steps[0], *(step for step in steps[1:] if step >= shortest)]


def longest_working(
    works: Callable[[float], bool],
    guess: float,
    shortest: float,
    longest: float,
    growth: float = GROWTH,
) -> float | None:
    """The longest step [s] that works, to LIMIT_KNOWN; None if none does.

    works: tells of a step, and is taken to fail for all longer ones where it fails for one.  guess:
    where to begin; shortest, longest: the ends of the search.
    """
    low = high = min(max(guess, shortest), longest)
    if works(low):
        while low < longest and works(high := min(growth * low, longest)):
            low = high
        if low >= longest:
            return longest
    else:
        while high > shortest and not works(low := max(high / growth, shortest)):
            high = low
        if high <= shortest:
            return None
    while high > (1.0 + LIMIT_KNOWN) * low:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if works(middle) else (low, middle)
    return low


@dataclass(frozen=True)
class Target:
    """What a search for an error came to."""

    dt: float | None
    """The longest step [s] found that is good enough; None if there is none."""
    reason: str = ""
    """Why there is none, in words."""


def longest_accurate(
    error: Callable[[float], float], target: float, longest: float, shortest: float
) -> Target:
    """The longest step [s] with an error of at most the target, to ACCURATE_KNOWN.

    error: error of a step, not finite where the run fails; it is taken to grow with the step.
    From the longest step downwards by halves, then by the secant through the logarithms.  Given up
    where halving the step does not help any more, and at the shortest step.
    """
    step, found = longest, error(longest)
    bad: tuple[float, float] | None = None
    flat = 0
    while not found <= target:
        if step <= shortest:
            return Target(None, f"the error is {found:.3g} even at dt = {step:.4g} s")
        previous, bad = found, (step, found)
        step = max(0.5 * step, shortest)
        found = error(step)
        flat = flat + 1 if found > PLATEAU * previous else 0
        if flat == 2 and not found <= target:
            return Target(None, f"the error stays at {found:.3g} however short the step")
    if bad is None:
        return Target(step)
    return Target(_refined(error, target, (step, found), bad))


def _refined(
    error: Callable[[float], float],
    target: float,
    good: tuple[float, float],
    bad: tuple[float, float],
) -> float:
    """The step between a good and a bad one at which the error passes the target."""
    for _ in range(REFINEMENTS):
        if bad[0] <= (1.0 + ACCURATE_KNOWN) * good[0]:
            break
        step = _between(good, bad, target)
        found = error(step)
        if found <= target:
            good = (step, found)
        else:
            bad = (step, found)
    return good[0]


def _between(good: tuple[float, float], bad: tuple[float, float], target: float) -> float:
    """By the secant in logarithms, kept off the ends; the middle where an error is not finite."""
    share = 0.5
    if math.isfinite(bad[1]) and 0.0 < good[1] < bad[1]:
        share = math.log(target / good[1]) / math.log(bad[1] / good[1])
    share = min(max(share, 0.15), 0.85)
    return float(good[0] * (bad[0] / good[0]) ** share)
