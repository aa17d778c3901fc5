"""Which method and which step are cheapest for an error, by what the methods are known to do."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from swe_sphere.planet import DAY
from swe_sphere.studies.advice.method import Method
from swe_sphere.studies.advice.setting import Setting

DATA = "methods.json"
SHORTEST = 1.0 / 64.0
"""No step is shorter than this part of the gravity limit."""
RATIO = 2.0**0.125
"""Between the steps that are looked at."""
LIMIT, ERROR, REACH, FAILURE = "stability", "error", "longest tried", "runs that failed"


@dataclass(frozen=True)
class Candidate:
    """A method with its best step for an error."""

    method: Method
    dt: float
    """[s]"""
    error: float
    """Predicted, without a margin."""
    cost: float
    """Predicted, of a day [right-hand sides]."""
    bound: str
    """What keeps the step from being longer."""


def candidates(
    setting: Setting, limits: Mapping[str, float], error: float, methods: Iterable[Method]
) -> list[Candidate]:
    """For each method that reaches the error its cheapest step, the cheapest method first.

    limits: longest step [s] of each stepper that is safe, by name; steppers without one there are
    left out.  A predicted error counts as met where it is so many times smaller as errors scatter
    about the prediction.
    """
    found = [
        best
        for method in methods
        if method.stepper in limits
        and (best := _best(method, setting, limits[method.stepper], error)) is not None
    ]
    return sorted(found, key=lambda candidate: candidate.cost)


def _best(method: Method, setting: Setting, limit: float, error: float) -> Candidate | None:
    courant, seen = method.reach
    reach = min(courant * setting.advective_limit, seen, 0.5 * setting.seconds)
    longest = limit if math.isfinite(limit) else reach
    count = int(math.log(longest / (SHORTEST * setting.gravity_limit)) / math.log(RATIO))
    steps = [longest / RATIO**n for n in range(max(count, 0) + 1)]
    safe = [dt for dt in steps if method.works(setting, dt)]
    good = [dt for dt in safe if method.error(setting, dt) * method.doubt <= error]
    if not good:
        return None
    dt = min(good, key=lambda dt: method.step_cost(setting, dt) / dt)
    bound = LIMIT if math.isfinite(limit) else REACH
    if dt < longest:
        bound = ERROR if dt < safe[0] else FAILURE
    cost = method.step_cost(setting, dt) * DAY / dt
    return Candidate(method, dt, method.error(setting, dt), cost, bound)


def as_text(methods: Sequence[Method]) -> str:
    """Methods as they are kept."""
    lines = ",\n".join(json.dumps(asdict(method)) for method in methods)
    return f"[\n{lines}\n]\n"


@cache
def known_methods() -> tuple[Method, ...]:
    """The methods whose constants come with the package."""
    text = files("swe_sphere.studies.advice").joinpath(DATA).read_text()
    return tuple(
        Method(**{name: _frozen(value) for name, value in table.items()})
        for table in json.loads(text)
    )


def _frozen(value: Any) -> Any:
    """Lists as tuples."""
    return tuple(map(_frozen, value)) if isinstance(value, list) else value
