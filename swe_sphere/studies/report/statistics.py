"""Which setting is best: only rows that were measured, never anything between them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from swe_sphere.studies.report.rows import Metric, Row

__all__ = [
    "Cost", "Plateau", "candidates", "cheapest", "cost", "pareto", "plateau", "smallest",
    "targets", "told_apart",
]  # fmt: skip

Cost = Callable[[Row], float]

GAIN = 0.01
MOST_TARGETS = 5
LONG = 6.0
"""Steps from so many times the gravity-wave limit on do not resolve the gravity waves."""
RANGE = 3.0
"""A plateau spans at least this factor in steps, and at most this factor in errors."""
BELOW = 0.5
"""A smaller error than this times the plateau's shows that there is something to resolve."""


def cost(row: Row) -> float:
    """What rows are ranked by [s]."""
    return row.cost


def candidates(rows: Iterable[Row], metric: Metric, cost: Cost = cost) -> list[Row]:
    """Rows that may be compared: completed, meant as a setting, with a cost and an error."""
    return [
        row
        for row in rows
        if row.compared and math.isfinite(row.error(metric)) and 0.0 < cost(row) < math.inf
    ]


def pareto(rows: Iterable[Row], metric: Metric, cost: Cost = cost, gain: float = GAIN) -> list[Row]:
    """Rows that no other row beats in both error and cost, by rising cost.

    Of rows equal in both the first stays.  A row whose error is smaller than that of a cheaper
    one by less than a part `gain` of it is left out: it costs more for nothing.
    """
    ordered = sorted(candidates(rows, metric, cost), key=lambda r: (cost(r), r.error(metric)))
    front: list[Row] = []
    for row in ordered:
        if not front or row.error(metric) < (1.0 - gain) * front[-1].error(metric):
            front.append(row)
    return front


def smallest(rows: Iterable[Row], metric: Metric) -> Row | None:
    """The row with the smallest error; of equal ones the cheapest."""
    found = candidates(rows, metric)
    return min(found, key=lambda r: (r.error(metric), r.cost), default=None)


def cheapest(rows: Iterable[Row], metric: Metric, target: float) -> Row | None:
    """The cheapest row whose error is not above the target."""
    good = (row for row in candidates(rows, metric) if row.error(metric) <= target)
    return min(good, key=cost, default=None)


def told_apart(a: Row, b: Row) -> bool:
    """Whether the costs of two rows differ by more than they are uncertain."""
    return a.interval[1] < b.interval[0] or b.interval[1] < a.interval[0]


def targets(groups: Iterable[Iterable[Row]], metric: Metric, resolved: float = 0.0) -> list[float]:
    """Round errors, falling: from one that each group reaches to the smallest that one does.

    Powers of ten, and three times these where that makes no more than MOST_TARGETS; of too many
    the smallest are left out.  resolved: errors below are not known well enough to be targets.
    """
    rows = [smallest(group, metric) for group in groups]
    best = [error for row in rows if row is not None and (error := row.error(metric)) > 0.0]
    if not best:
        return []
    low, high = max(min(best), resolved), max(best)
    powers = range(math.floor(math.log10(low)) - 1, math.ceil(math.log10(high)) + 2)
    for factors in ((3.0, 1.0), (1.0,)):
        grid = sorted((float(f"{f:.0f}e{p}") for p in powers for f in factors), reverse=True)
        by_all = [level for level in grid if level >= high][-1:]
        found = by_all + [level for level in grid if low <= level < high]
        if len(found) <= MOST_TARGETS:
            break
    return found[:MOST_TARGETS]


@dataclass(frozen=True)
class Plateau:
    """Errors of long steps that hardly depend on the step."""

    lowest: Row
    """The row with the smallest error of it."""
    highest: Row
    shortest: Row
    """The row with the shortest step of it."""
    longest: Row
    best: Row
    """The row with the smallest error of all."""
    everywhere: bool
    """Whether short steps do no better: then it is the mesh's error, not that of the steps."""


def plateau(rows: Iterable[Row], metric: Metric) -> Plateau | None:
    """The plateau of an error on one mesh at steps that do not resolve gravity waves, if any.

    Initial states that are not in balance shed gravity waves; every stepper with a long step
    damps or dephases them, whatever the step, and its depth differs by about their amplitude.
    None where the error of most steppers grows with the step, or where too few steps tell.
    """
    rows = candidates(rows, metric)
    best = smallest(rows, metric)
    long = [row for row in rows if row.gravity_multiple >= LONG]
    if best is None or not any(row.gravity_multiple < LONG for row in rows):
        return None
    steppers = dict.fromkeys(row.stepper for row in long)
    told = [part for name in steppers if _spans(part := [r for r in long if r.stepper == name])]
    flat = [part for part in told if _is_flat(part, metric)]
    if 2 * len(flat) <= len(told):
        return None
    members = [row for part in flat for row in part]
    lowest, highest = (f(members, key=lambda r: r.error(metric)) for f in (min, max))
    shortest, longest = (f(members, key=lambda r: r.dt) for f in (min, max))
    everywhere = best.error(metric) >= BELOW * lowest.error(metric)
    return Plateau(lowest, highest, shortest, longest, best, everywhere)


def _spans(rows: list[Row]) -> bool:
    steps: list[float] = [row.dt for row in rows]
    return max(steps) >= RANGE * min(steps)


def _is_flat(rows: list[Row], metric: Metric) -> bool:
    errors = [row.error(metric) for row in rows]
    return max(errors) <= RANGE * min(errors)
