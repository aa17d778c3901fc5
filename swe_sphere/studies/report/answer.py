"""What a sweep says at a glance: one sentence, and a table of target errors by steppers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from swe_sphere.studies.report import words
from swe_sphere.studies.report.palette import Curve, curves
from swe_sphere.studies.report.rows import KINDS, Metric, Row
from swe_sphere.studies.report.statistics import cheapest, plateau, smallest, targets, told_apart

ANSWERED = {"total": ("h", "v", "vorticity"), "time": ("h", "v", "vorticity"),
            "slow": ("vorticity", "h", "v")}  # fmt: skip
"""For each kind of error the field that steppers are ranked by: the first one there is."""
BEST, TIE = "★ ", "≈ "
"""Marks of the cheapest row for a target, and of those that cannot be told from it."""


@dataclass(frozen=True)
class Ranking:
    """Who reaches which error at which cost, on one mesh."""

    where: str
    """For example "williamson5, ne16 np4"."""
    metric: Metric
    targets: list[float]
    """Falling."""
    lines: list[tuple[Curve, list[Row | None]]]
    """For each stepper the cheapest row for each target, and the row of its smallest error."""
    notes: list[str]
    """What to keep in mind."""

    def winners(self, target: int) -> list[Row]:
        """The cheapest row for a target, by its number, and those that cannot be told from it."""
        cells = (cells[target] for cells in self.rows)
        found = [row for row in cells if row is not None and row.timed]
        found.sort(key=lambda row: row.cost)
        return [row for row in found if not told_apart(found[0], row)]

    @property
    def clock(self) -> str:
        """Name of the time that steppers are ranked by; empty where none was taken."""
        rows = (row for cells in self.rows for row in cells if row is not None)
        return next((row.clock for row in rows if row.timed), "")

    @property
    def rows(self) -> list[list[Row | None]]:
        """Those of the table, for each stepper."""
        return [cells for _, cells in self.lines]

    @property
    def heads(self) -> list[str]:
        """Of the table."""
        return ["stepper", *(f"≤ {words.level(t)}" for t in self.targets), "smallest error"]

    @cached_property
    def body(self) -> list[list[str]]:
        """The lines of the table: names, then step, cost and error, marked where the cheapest."""
        winners = [self.winners(i) for i in range(len(self.targets))] + [[]]
        return [
            [
                curve.label,
                *(self._cell(row, best) for row, best in zip(cells, winners, strict=True)),
            ]
            for curve, cells in self.lines
        ]

    def _cell(self, row: Row | None, best: list[Row]) -> str:
        if row is None:
            return words.NOTHING
        mark = "" if row not in best else BEST if len(best) == 1 else TIE
        error = words.error(row.error(self.metric))
        seconds = f" {words.seconds(row.cost)}," if row.timed else ""
        return f"{mark}{words.step(row.dt)},{seconds} {error}"

    @property
    def caption(self) -> str:
        """How to read the table."""
        if not self.clock:
            return f"For each target of {self.metric.label} the longest step: Δt, error."
        return (
            f"For each target of {self.metric.label} the cheapest run of each stepper: Δt, "
            f"{self.clock}, error. {BEST}cheapest; {TIE}cheapest too: they differ by less than "
            "their uncertainty."
        )

    @property
    def headline(self) -> str:
        """One sentence on the smallest target that two steppers reach, or else one."""
        if not self.clock:
            return f"Errors only on {self.where}: no run was timed, so that none is ranked by cost."
        if not self.targets:
            return f"All errors on {self.where} are zero."
        reached = [
            sum(cells[i] is not None for cells in self.rows) for i in range(len(self.targets))
        ]
        for fewest in (2, 1):
            if told := [i for i, count in enumerate(reached) if count >= fewest]:
                return self._sentence(told[-1])
        best = min(cells[-1].error(self.metric) for cells in self.rows if cells[-1] is not None)
        return (
            f"No run on {self.where} reaches an error of {words.level(self.targets[-1])}: the "
            f"smallest is {words.error(best)}."
        )

    def _sentence(self, i: int) -> str:
        names = {id(cells[i]): curve.label for curve, cells in self.lines}
        best = self.winners(i)
        if not best:
            return f"No run on {self.where} that reaches {words.level(self.targets[i])} was timed."
        first = best[0]
        kind = KINDS.get(self.metric.kind, self.metric.kind)
        others = [row for cells in self.rows if (row := cells[i]) and row not in best]
        others = [row for row in others if row.timed]
        after = min(others, key=lambda row: row.cost, default=None)
        who = _listed([names[id(row)] for row in best]) + (" tie;" if len(best) > 1 else ",")
        gap = words.times(after.cost / first.cost) if after else ""
        return (
            f"Cheapest to {self.metric.symbol} ≤ {words.level(self.targets[i])} ({kind}, day "
            f"{self.metric.day:g}) on {self.where}: {who} Δt {words.step(first.dt)}, "
            f"{words.seconds(first.cost)} of {self.clock} (row {first.number})"
            + (f"; next is {names[id(after)]} at {gap} that." if after else ".")
        )


def rankings(
    rows: Sequence[Row], found: Sequence[Metric], where: str, own: float = math.nan,
    levels: Sequence[float] = (),
) -> list[Ranking]:  # fmt: skip
    """One for each kind of error that some row has, the one to rank by first.

    That is the first of total, time and slow-flow error, but the slow one where the depth
    saturates.  rows: of one mesh.  own: time error of the converged run that time errors are taken
    against.  levels: targets asked for.
    """
    made, saturated = [], ""
    for metric in _spoken(found):
        text = _saturation(rows, metric, any(m.kind == "slow" for m in found))
        saturated = saturated or (text if "saturates" in text else "")
        made.append(_ranking(rows, metric, where, own, levels, [text] if text else []))
    made.sort(key=lambda ranking: ranking.metric.kind != "slow" and bool(saturated))
    return [ranking for ranking in made if ranking.lines]


def _spoken(found: Sequence[Metric]) -> list[Metric]:
    by_name = {(metric.kind, metric.field): metric for metric in found}
    first = (
        next((by_name[kind, field] for field in order if (kind, field) in by_name), None)
        for kind, order in ANSWERED.items()
    )
    return [metric for metric in first if metric is not None]


def _ranking(
    rows: Sequence[Row], metric: Metric, where: str, own: float, levels: Sequence[float],
    notes: list[str],
) -> Ranking:  # fmt: skip
    drawn = [curve for curve in curves(rows) if smallest(curve.rows, metric) is not None]
    # the check of the converged run is on its depth
    resolved = own if (metric.kind, metric.field) == ("time", "h") and own > 0.0 else 0.0
    wanted = [level for level in sorted(levels, reverse=True) if level >= resolved]
    wanted = wanted or targets([curve.rows for curve in drawn], metric, resolved)
    lines: list[tuple[Curve, list[Row | None]]] = [
        (c, [*(cheapest(c.rows, metric, t) for t in wanted), smallest(c.rows, metric)])
        for c in drawn
    ]
    lines.sort(
        key=lambda line: [
            row.cost if row is not None and row.timed else math.inf for row in line[1]
        ]
    )
    return Ranking(where, metric, wanted, lines, notes)


def _saturation(rows: Sequence[Row], metric: Metric, slow: bool) -> str:
    """What an error of the depth that does not depend on the step means; empty where it does.

    slow: whether the slow-flow error was measured too.
    """
    found = plateau(rows, metric) if metric.field == "h" and metric.kind != "slow" else None
    if found is None:
        return ""
    span = f"{words.step(found.shortest.dt)} to {words.step(found.longest.dt)}"
    low, high = (words.error(row.error(metric)) for row in (found.lowest, found.highest))
    if found.everywhere:
        return (
            f"{metric.symbol} does not depend on the step, from {span} {low} (row "
            f"{found.lowest.number}) to {high} (row {found.highest.number}): the error of the mesh."
        )
    best = words.error(found.best.error(metric))
    rank = " The slow-flow error ranks steppers instead." if slow else ""
    return (
        f"{metric.symbol} saturates: from {span} it stays between {low} (row {found.lowest.number})"
        f" and {high} (row {found.highest.number}), against {best} of {found.best.stepper} (row "
        f"{found.best.number}): the size of gravity waves of the start, which long steps damp or "
        f"dephase.{rank}"
    )


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
