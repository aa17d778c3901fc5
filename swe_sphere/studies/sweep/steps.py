"""Which steps to take: sequences, and searches for the longest that works or is accurate."""

import math
from collections.abc import Callable

RATIO = math.sqrt(2.0)
"""Between the steps of an explicit stepper, whose useful range is short."""
FARTHEST = 64.0
"""The longest implicit step, in gravity limits: what studies found useful, and a little more."""
SHORTEST = 2.0
"""The shortest one; below, an explicit stepper does the same for a fraction of the time."""

REFINEMENTS = 6
LIMIT_KNOWN, ACCURATE_KNOWN = 0.02, 0.05
"""How closely searches find the longest step that works, or is accurate; relative."""
PLATEAU = 0.9
"""An error that a halved step leaves above this part of itself does not depend on the step."""


TRIAL_STEPS, TRIAL_DAYS = 100, 5.0
"""A trial of stability takes so many steps and so many days at least, and those of the sweep."""
PERTURBATION = 1e-7
"""Size of the noise that must not grow in a trial, relative to the largest value of a field."""
GROWN, GROWTH_OF_FLOW = 10.0, 0.5
"""A stable step amplifies it by at most the first, times e to the second for each day: flows too
are unstable."""


class NoStepError(Exception):
    """No step is good enough; the text says why."""


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


def longest_working(
    works: Callable[[float], bool], guess: float, shortest: float, longest: float, growth: float
) -> float | None:
    """The longest step [s] that works, to LIMIT_KNOWN; None if none does.

    works: tells of a step, and is taken to fail for all longer ones where it fails for one.  guess:
    where to begin; shortest, longest: the ends of the search; growth: ratio of two steps while the
    limit is not yet enclosed.
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


def longest_accurate(
    error: Callable[[float], float], target: float, longest: float, shortest: float
) -> float:
    """The longest step [s] with an error of at most the target, to ACCURATE_KNOWN.

    error: error of a step, not finite where the run fails; it is taken to grow with the step.
    From the longest step downwards by halves, then by the secant through the logarithms.  Raises
    NoStepError where halving the step does not help any more, and at the shortest step.
    """
    step, found = longest, error(longest)
    too_long: tuple[float, float] | None = None
    flat = 0
    while not found <= target:
        if step <= shortest:
            raise NoStepError(f"the error is {found:.3g} even at dt = {step:.4g} s")
        too_long = (step, found)
        step = max(0.5 * step, shortest)
        found = error(step)
        flat = flat + 1 if found > PLATEAU * too_long[1] else 0
        if flat == 2 and not found <= target:
            raise NoStepError(f"the error stays at {found:.3g} however short the step")
    for _ in range(REFINEMENTS):
        if too_long is None or too_long[0] <= (1.0 + ACCURATE_KNOWN) * step:
            break
        share = 0.5  # the middle where an error is not finite
        if math.isfinite(too_long[1]) and 0.0 < found < too_long[1]:
            share = math.log(target / found) / math.log(too_long[1] / found)
        tried = step * (too_long[0] / step) ** min(max(share, 0.15), 0.85)
        if (value := error(tried)) <= target:
            step, found = tried, value
        else:
            too_long = (tried, value)
    return step
