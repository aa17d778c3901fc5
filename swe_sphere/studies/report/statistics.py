"""Which setting is best: only rows that were measured, never anything between them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

from swe_sphere.studies.report.rows import Metric, Row

__all__ = [
    "Cost", "candidates", "cheapest", "error_levels", "pareto", "smallest", "tiers",
    "time_interval", "told_apart",
]  # fmt: skip

Cost = Callable[[Row], float]

UNKNOWN_NOISE = 0.1
"""Taken for the spread of timings where none was recorded."""
GAIN = 0.01
LEVELS = 4
"""At most so many error levels are spoken of."""


def wall(row: Row) -> float:
    """Median wall time of the steps alone [s]."""
    return row.wall_seconds


def candidates(rows: Iterable[Row], metric: Metric, cost: Cost = wall) -> list[Row]:
    """Rows that may be compared: completed, meant as a setting, with a cost and an error."""
    return [
        row
        for row in rows
        if row.compared and math.isfinite(row.error(metric)) and 0.0 < cost(row) < math.inf
    ]


def pareto(rows: Iterable[Row], metric: Metric, cost: Cost = wall, gain: float = GAIN) -> list[Row]:
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
    return min(found, key=lambda r: (r.error(metric), r.wall_seconds), default=None)


def cheapest(rows: Iterable[Row], metric: Metric, level: float) -> list[Row]:
    """For each stepper that reaches an error level its cheapest row, by rising wall time."""
    best: dict[str, Row] = {}
    for row in sorted(candidates(rows, metric), key=wall):
        if row.error(metric) <= level:
            best.setdefault(row.stepper, row)
    return list(best.values())


def time_interval(row: Row, noise: float = math.nan) -> tuple[float, float]:
    """Within which wall times [s] the row's true one may lie.

    From its fastest to its slowest repeat, or half its spread to either side of the median where
    single times are not known, and at least half of `noise`, the relative spread (largest -
    smallest, over median) of a calibration run on the same machine, to either side.  Where
    neither is known (a run timed once), UNKNOWN_NOISE stands for `noise`.
    """
    median = row.wall_seconds
    times = row.walls if len(row.walls) > 1 else ()
    spread = row.wall_spread if row.wall_spread > 0.0 else 0.0
    if not times and spread == 0.0 and not noise >= 0.0:
        noise = UNKNOWN_NOISE
    half = 0.5 * max(noise if noise >= 0.0 else 0.0, 0.0 if times else spread) * median
    return min(*times, median, median - half), max(*times, median, median + half)


def told_apart(a: Row, b: Row, noise: float = math.nan) -> bool:
    """Whether the wall times of two rows differ by more than their noise."""
    (low_a, high_a), (low_b, high_b) = time_interval(a, noise), time_interval(b, noise)
    return high_a < low_b or high_b < low_a


def tiers(rows: Iterable[Row], noise: float = math.nan) -> list[list[Row]]:
    """Rows by rising wall time, those together that cannot be told from the first among them."""
    ranked: list[list[Row]] = []
    for row in sorted(rows, key=wall):
        if ranked and not told_apart(ranked[-1][0], row, noise):
            ranked[-1].append(row)
        else:
            ranked.append([row])
    return ranked


def error_levels(rows: Iterable[Row], metric: Metric) -> list[float]:
    """Round error levels, falling: from one that every stepper reaches to one that none does.

    Powers of ten, and three times these where the errors span less than a factor of hundred.
    Where there are more than LEVELS the smallest ones are left out.
    """
    best: dict[str, float] = {}
    for row in candidates(rows, metric):
        if (error := row.error(metric)) > 0.0:
            best[row.stepper] = min(error, best.get(row.stepper, math.inf))
    if not best:
        return []
    low, high = min(best.values()), max(best.values())
    factors = (1.0, 3.0) if high < 100.0 * low else (1.0,)
    powers = range(math.floor(math.log10(low)) - 1, math.ceil(math.log10(high)) + 1)
    grid = sorted((float(f"{f:.0f}e{p}") for p in powers for f in factors), reverse=True)
    by_all = [level for level in grid if level >= high]
    between = [level for level in grid if low <= level < high]
    by_none = [level for level in grid if level < low]
    return [by_all[-1], *between, by_none[0]][:LEVELS]
