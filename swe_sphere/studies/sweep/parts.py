"""What of a sweep can be made beside each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from swe_sphere.studies.sweep.runspec import Integrator
from swe_sphere.studies.sweep.sweep_plan import SweepPlan


@dataclass(frozen=True)
class Part:
    """Runs of an integrator, by its number, that one process makes one after the other."""

    what: Literal["grid", "search", "limit"]
    integrator: int
    first: int = 0
    last: int | None = None
    """Which of its grid, the last excluded."""


def parts_of(plan: SweepPlan, everyone: Sequence[Integrator]) -> list[Part]:
    """All parts; the shortest steps come first, so that nobody is left with them at the end."""
    found = [part for n, each in enumerate(everyone) for part in _parts(plan, n, each)]
    return sorted(found, key=lambda part: part.first, reverse=True)


def _parts(plan: SweepPlan, n: int, integrator: Integrator) -> Iterator[Part]:
    if plan.find_limit:
        yield Part("limit", n)
    if plan.target_error is not None:
        yield Part("search", n)
    elif plan.enough is not None:  # which runs are needed shows on the way
        yield Part("grid", n)
    else:
        for i in range(len(integrator.grid(plan))):
            yield Part("grid", n, i, i + 1)
