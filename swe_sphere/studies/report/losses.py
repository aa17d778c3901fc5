"""The table of largest steps: stable ones, and those without loss of accuracy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from swe_sphere.studies.report import words
from swe_sphere.studies.report.loss import BASELINE, SLACK, Threshold, largest_step, threshold
from swe_sphere.studies.report.palette import curves
from swe_sphere.studies.report.rows import MADE_FOR_OTHERS, Metric, Row

__all__ = ["LossTable", "loss_table"]

RULE = (
    "A step is without loss of accuracy if the error is at most "
    f"{SLACK:g} times the smallest that any stepper reaches on the mesh or {SLACK:g} times that "
    f"of the run converged in time, or that of {BASELINE} at its largest step; it counts if all "
    "shorter measured steps of the stepper are without loss too. In brackets: multiples of the "
    "gravity-wave limit and of the advective limit."
)


@dataclass(frozen=True)
class LossTable:
    """For each stepper its largest steps, in words."""

    rule: str
    heads: list[str]
    lines: list[list[str]]
    """A line for each stepper: its name, then one text for each further head."""
    limits: list[str]
    """For each error, which limit its column rests on."""


def loss_table(rows: Sequence[Row], found: Sequence[Metric]) -> LossTable:
    """The table for the rows of one mesh.

    Errors are the total ones and those of the slow flow; time errors where there are no others,
    as any stepper's shortest step is without time error.
    """
    chosen = [m for m in found if m.kind in ("total", "slow")] or list(found)
    limits = {m: limit for m in chosen if (limit := threshold(rows, m)) is not None}
    heads = ["stepper", "largest completed step", "first failure"]
    lines = [
        [curve.label, _longest(curve.rows), _failure(curve.rows)]
        + [_step(largest_step(curve.rows, m, limit.value)) for m, limit in limits.items()]
        for curve in curves(row for row in rows if row.role not in MADE_FOR_OTHERS)
    ]
    return LossTable(
        RULE,
        heads + [f"{m.symbol}, {m.title.split(',')[0]}" for m in limits],
        lines if limits else [],
        [_limit(metric, limit) for metric, limit in limits.items()],
    )


def _step(row: Row | None) -> str:
    if row is None:
        return "none"
    multiples = f"{words.times(row.gravity_multiple)}, {words.times(row.advective_multiple)}"
    return f"{words.step(row.dt)} ({multiples}; row {row.number})"


def _longest(rows: Sequence[Row]) -> str:
    return _step(max((r for r in rows if r.completed), key=lambda r: r.dt, default=None))


def _failure(rows: Sequence[Row]) -> str:
    """The shortest step at which the scheme itself failed."""
    failed = [row for row in rows if row.status in ("unstable", "solver-failed")]
    row = min(failed, key=lambda r: r.dt, default=None)
    return f"{words.step(row.dt)}, {row.status} (row {row.number})" if row else "none"


def _limit(metric: Metric, limit: Threshold) -> str:
    best = limit.best
    text = (
        f"{metric.label}: at most {words.error(limit.value, 2)}; smallest error "
        f"{words.error(best.error(metric), 2)}, {best.stepper} at {words.step(best.dt)} "
        f"(row {best.number})"
    )
    if limit.converged is not None:
        mesh = words.error(limit.converged.error(metric), 2)
        text += f"; converged in time it is {mesh} (row {limit.converged.number})"
    if limit.baseline is None:
        return f"{text}; no {BASELINE} to compare with."
    base = limit.baseline
    return (
        f"{text}; {base.stepper} at {words.step(base.dt)} has {words.error(base.error(metric), 2)} "
        f"(row {base.number})."
    )
