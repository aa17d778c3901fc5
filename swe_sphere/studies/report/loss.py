"""The largest step without loss of accuracy, as Evans, Taylor & Drake (2010) ask for it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from swe_sphere.studies.report.rows import Metric, Row
from swe_sphere.studies.report.statistics import candidates, smallest

__all__ = ["BASELINE", "SLACK", "Threshold", "largest_step", "threshold"]

SLACK = 1.1
BASELINE = "leapfrog"


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
    failed = {row.number for row in rows if row.status in ("unstable", "solver-failed")}
    for row in sorted(rows, key=lambda r: (r.dt, -r.error(metric))):
        if row.number in failed or (row.number in compared and row.error(metric) > limit):
            break
        largest = row if row.number in compared else largest
    return largest
