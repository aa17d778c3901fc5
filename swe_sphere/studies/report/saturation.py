"""Errors that do not grow with the step: what they are made of is not the stepper's doing."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from swe_sphere.studies.report.rows import Metric, Row
from swe_sphere.studies.report.statistics import candidates, smallest

__all__ = ["Plateau", "plateau"]

LONG = 6.0
"""Steps from so many times the gravity-wave limit on do not resolve the gravity waves."""
RANGE = 3.0
"""A plateau spans at least this factor in steps, and at most this factor in errors."""
BELOW = 0.5
"""A smaller error than this times the plateau's shows that there is something to resolve."""


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
    by_stepper = {
        name: [r for r in long if r.stepper == name]
        for name in dict.fromkeys(row.stepper for row in long)
    }
    told = [part for part in by_stepper.values() if _spans(part)]
    flat = [row for part in told if _is_flat(part, metric) for row in part]
    if 2 * len({row.stepper for row in flat}) <= len(told):
        return None
    lowest, highest = (f(flat, key=lambda r: r.error(metric)) for f in (min, max))
    shortest, longest = (f(flat, key=lambda r: r.dt) for f in (min, max))
    everywhere = best.error(metric) >= BELOW * lowest.error(metric)
    return Plateau(lowest, highest, shortest, longest, best, everywhere)


def _spans(rows: list[Row]) -> bool:
    return max(row.dt for row in rows) >= RANGE * min(row.dt for row in rows)


def _is_flat(rows: list[Row], metric: Metric) -> bool:
    errors = [row.error(metric) for row in rows]
    return max(errors) <= RANGE * min(errors)
