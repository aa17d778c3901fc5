"""The largest step without loss of accuracy, as Evans, Taylor & Drake (2010) ask for it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from swe_sphere.studies.report import words
from swe_sphere.studies.report.palette import curves
from swe_sphere.studies.report.rows import MADE_FOR_OTHERS, Metric, Row
from swe_sphere.studies.report.statistics import candidates, smallest
from swe_sphere.studies.report.table import Table

__all__ = ["BASELINE", "SLACK", "Threshold", "largest_step", "largest_steps", "threshold"]

SLACK = 1.1
BASELINE = "leapfrog"
FAILED = ("unstable", "solver-failed")
"""How runs end whose scheme is to blame."""
RULE = (
    f"A step is without loss of accuracy if its error is at most {SLACK:g} times the smallest of "
    f"any stepper or {SLACK:g} times that of the run converged in time, or that of {BASELINE} at "
    "its largest step; all shorter measured steps have to be without loss too. In brackets: "
    "multiples of the gravity-wave and of the advective limit."
)


@dataclass(frozen=True)
class Threshold:
    """An error that counts as no loss of accuracy, and the rows it comes from."""

    value: float
    best: Row
    """The row with the smallest error."""
    baseline: Row | None = None
    """The explicit stepper's row, None where there is none."""
    converged: Row | None = None
    """The run converged in time, whose total error is that of the mesh; None where unknown."""


def threshold(
    rows: Iterable[Row], metric: Metric, baseline: str = BASELINE, slack: float = SLACK
) -> Threshold | None:
    """Up to which error nothing is lost, among rows of one mesh; None where no row has one.

    The largest of `slack` times the smallest error that any stepper reaches, `slack` times the
    error of the run converged in time, which no step can be blamed for, and the error of the
    baseline stepper at its largest completed step: who is as good as the explicit scheme at the
    step that one would run it with has lost nothing (Evans, Taylor & Drake 2010 compare so).
    """
    rows = list(rows)
    best = smallest(rows, metric)
    if best is None:
        return None
    explicit = [row for row in candidates(rows, metric) if row.stepper == baseline]
    base = max(explicit, key=lambda row: row.dt, default=None)
    exact = [r for r in rows if r.role == "converged" and math.isfinite(r.error(metric))]
    converged = min(exact, key=lambda row: row.dt, default=None)
    values = [slack * row.error(metric) for row in (best, converged) if row is not None]
    values += [] if base is None else [base.error(metric)]
    return Threshold(max(values), best, base, converged)


def largest_step(rows: Sequence[Row], metric: Metric, limit: float) -> Row | None:
    """The row with the largest step up to which the error stays within a limit.

    rows: of one stepper on one mesh.  Steps count from the smallest measured one up to the first
    that fails or whose error exceeds the limit: a longer one beyond it that happens to have a
    small error does not count.  A run that was cut short or refused says nothing either way.
    None if the smallest step already exceeds it.
    """
    largest = None
    compared = {row.number for row in candidates(rows, metric)}
    for row in sorted(rows, key=lambda r: (r.dt, -r.error(metric))):
        known = row.number in compared
        if row.status in FAILED or (known and row.error(metric) > limit):
            break
        largest = row if known else largest
    return largest


def largest_steps(rows: Sequence[Row], found: Sequence[Metric]) -> Table | None:
    """The table for the rows of one mesh: stable steps, and those without loss of accuracy.

    Errors are the total ones and those of the slow flow; time errors where there are no others,
    as any stepper's shortest step is without time error.  None where there are no errors.
    """
    chosen = [m for m in found if m.kind in ("total", "slow")] or list(found)
    limits = {m: limit for m in chosen if (limit := threshold(rows, m)) is not None}
    if not limits:
        return None
    heads = ["stepper", "largest completed step", "first failure"]
    lines = [
        [curve.label, _longest(curve.rows), _failure(curve.rows)]
        + [_step(largest_step(curve.rows, m, limit.value)) for m, limit in limits.items()]
        for curve in curves(row for row in rows if row.role not in MADE_FOR_OTHERS)
    ]
    heads += [f"{m.symbol}, {m.title.split(',')[0]}" for m in limits]
    return Table(heads, lines, [RULE, *(_limit(metric, limit) for metric, limit in limits.items())])


def _step(row: Row | None) -> str:
    if row is None:
        return "none"
    multiples = f"{words.times(row.gravity_multiple)}, {words.times(row.advective_multiple)}"
    return f"{words.step(row.dt)} ({multiples}; row {row.number})"


def _longest(rows: Sequence[Row]) -> str:
    return _step(max((r for r in rows if r.completed), key=lambda r: r.dt, default=None))


def _failure(rows: Sequence[Row]) -> str:
    """The shortest step at which the scheme itself failed."""
    failed = [row for row in rows if row.status in FAILED]
    row = min(failed, key=lambda r: r.dt, default=None)
    return f"{words.step(row.dt)}, {row.status} (row {row.number})" if row else "none"


def _limit(metric: Metric, limit: Threshold) -> str:
    """What the column of an error rests on."""
    sources = {
        "smallest": limit.best,
        "converged in time": limit.converged,
        BASELINE: limit.baseline,
    }
    told = [
        f"{name} {words.error(row.error(metric), 2)} ({row.stepper}, {words.step(row.dt)}, "
        f"row {row.number})"
        for name, row in sources.items()
        if row is not None
    ]
    return f"{metric.label}: at most {words.error(limit.value, 2)}; {'; '.join(told)}."
