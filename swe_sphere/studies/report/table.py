"""Tables of a page: largest steps, all runs; and the rows of a sweep as CSV."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import StringIO
from typing import Any

from swe_sphere.studies.report import words
from swe_sphere.studies.report.palette import curves
from swe_sphere.studies.report.rows import MADE_FOR_OTHERS, Metric, Row
from swe_sphere.studies.report.statistics import FAILED, Threshold, largest_step, threshold


@dataclass(frozen=True)
class LargestSteps:
    """A table of texts, and the errors that its columns are held against."""

    heads: list[str]
    lines: list[list[str]]
    limits: dict[Metric, Threshold]


@dataclass(frozen=True)
class Column:
    """A column of the table of all runs."""

    title: str
    value: Callable[[Row], Any]
    text: Callable[[float], str] | None = None
    """How numbers are written; None where there are words."""
    essential: bool = False
    """Whether short tables have it."""

    def cell(self, row: Row) -> str:
        """What is shown of a row."""
        return str(self.value(row) if self.text is None else self.text(self.value(row)))

    def sort_key(self, row: Row) -> str:
        """What to sort by; empty: last."""
        value = self.value(row)
        return str(value) if self.text is None else repr(value) if math.isfinite(value) else ""


def how_it_ended(row: Row) -> str:
    """In words: the reason where there is one, else the status."""
    if row.completed or not row.reason:
        return str(row.status)
    return f"{row.status}: {row.reason}"


def columns(rows: Sequence[Row], metrics: Sequence[Metric]) -> list[Column]:
    """The columns that say something about these rows."""
    return [
        column
        for column in (*_SETTINGS, *(_error_column(metric) for metric in metrics), *_COSTS)
        if column.essential or any(column.cell(row) not in ("", words.NOTHING) for row in rows)
    ]


def _error_column(metric: Metric) -> Column:
    title = f"{metric.symbol} {metric.kind}, day {metric.day:g}"
    return Column(title, lambda row: row.error(metric), words.error, essential=True)


def _signed(value: float) -> str:
    return f"+{words.error(value)}" if value > 0.0 else words.error(value)


_SETTINGS = (
    Column("row", lambda r: float(r.number), words.count, essential=True),
    Column("stepper", lambda r: r.stepper, essential=True),
    Column("preconditioner", lambda r: r.preconditioner),
    Column("mesh", lambda r: r.mesh),
    Column("Δt", lambda r: r.dt, words.step, essential=True),
    Column("Δt / gravity limit", lambda r: r.gravity_multiple, words.times, essential=True),
    Column("Δt / advective limit", lambda r: r.advective_multiple, words.times, essential=True),
    Column("how it ended", how_it_ended, essential=True),
)
_COSTS = (
    Column("CPU", lambda r: r.cpu_seconds, words.seconds, essential=True),
    Column("spread", lambda r: r.spread, words.percent, essential=True),
    Column("wall", lambda r: r.wall_seconds, words.seconds),
    Column("right-hand sides", lambda r: r.rhs_evaluations, words.count, essential=True),
    Column("Jacobian products", lambda r: r.tangent_evaluations, words.count, essential=True),
    Column("preconditionings", lambda r: r.preconditioner_applications, words.count, True),
    Column("Newton a step", lambda r: r.per_step("newton_iterations"), words.number),
    Column("Krylov a step", lambda r: r.per_step("krylov_iterations"), words.number, True),
    Column("rejected steps", lambda r: r.rejected_steps, words.count),
    Column("mass drift", lambda r: r.mass_drift, _signed),
    Column("energy drift", lambda r: r.energy_drift, _signed, essential=True),
    Column("enstrophy drift", lambda r: r.enstrophy_drift, _signed),
    Column("compilation", lambda r: r.compile_seconds, words.seconds),
    Column("memory", lambda r: r.peak_memory, words.bytes_text),
    Column("precision", lambda r: r.precision),
    Column("device", lambda r: r.device),
    Column("settings", lambda r: r.settings),
    Column("days", lambda r: r.days, words.number),
    Column("steps", lambda r: r.steps, words.count),
    Column("role", lambda r: r.role),
)


def largest_steps(rows: Sequence[Row], found: Sequence[Metric]) -> LargestSteps | None:
    """The table for the rows of one mesh: stable steps, and those without loss of accuracy.

    Errors are the total ones and those of the slow flow; time errors where there are no others,
    as any stepper's shortest step is without time error.  None where there are no errors.
    """
    chosen = [m for m in found if m.kind in ("total", "slow")] or list(found)
    limits = {m: limit for m in chosen if (limit := threshold(rows, m)) is not None}
    if not limits:
        return None
    heads = ["stepper", "largest completed step", "first failure"]
    heads += [f"{m.symbol}, {m.title.split(',')[0]}" for m in limits]
    lines = [
        [curve.label, _longest(curve.rows), _failure(curve.rows)]
        + [step_text(largest_step(curve.rows, m, limit.value)) for m, limit in limits.items()]
        for curve in curves(row for row in rows if row.role not in MADE_FOR_OTHERS)
    ]
    return LargestSteps(heads, lines, limits)


def step_text(row: Row | None, numbered: bool = True) -> str:
    """The step of a row with the multiples of its limits; numbered: and with the row's number."""
    if row is None:
        return "none"
    multiples = f"{words.times(row.gravity_multiple)}, {words.times(row.advective_multiple)}"
    return f"{words.step(row.dt)} ({multiples}{f'; row {row.number}' if numbered else ''})"


def _longest(rows: Sequence[Row]) -> str:
    return step_text(max((r for r in rows if r.completed), key=lambda r: r.dt, default=None))


def _failure(rows: Sequence[Row]) -> str:
    """The shortest step at which the scheme itself failed."""
    failed = [row for row in rows if row.status in FAILED]
    row = min(failed, key=lambda r: r.dt, default=None)
    return f"{words.step(row.dt)}, {row.status} (row {row.number})" if row else "none"


def csv_text(named: Sequence[tuple[str, Sequence[Row]]]) -> str:
    """All that is known of the rows of named datasets, in SI units; every error in a column.

    Fields that are not finite are empty.
    """
    found = {metric for _, rows in named for row in rows for metric in row.errors}
    metrics = sorted(found, key=lambda metric: metric.name)
    names = [*dict.fromkeys(name for _, rows in named for row in rows for name in row.values)]
    out = StringIO()
    writer = csv.writer(out, lineterminator="\n")
    heads = ["dataset", "number", *names]
    writer.writerow([*heads, *(metric.name for metric in metrics)])
    for dataset, rows in named:
        for row in rows:
            known = (row.values.get(name) for name in names)
            values = map(_plain, (*known, *map(row.error, metrics)))
            writer.writerow([dataset, row.number, *values])
    return out.getvalue()


def _plain(value: object) -> object:
    if not isinstance(value, float):
        return value
    return "" if not math.isfinite(value) else int(value) if value == int(value) else value
