"""Which setting is best: only runs that were measured, never anything between them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from swe_sphere.studies import words
from swe_sphere.studies.pages import prose
from swe_sphere.studies.report.rows import Curve, Metric, Row, curves

Cost = Callable[[Row], float]

GAIN = 0.01
MOST_TARGETS = 5
LONG = 6.0
"""Steps from so many times the gravity-wave limit on do not resolve the gravity waves."""
RANGE = 3.0
"""A plateau spans at least this factor in steps, and at most this factor in errors."""
BELOW = 0.5
"""A smaller error than this times the plateau's shows that there is something to resolve."""
SLACK = 1.1
BASELINE = "leapfrog"
FAILED = ("unstable", "solver-failed")
"""Status of runs whose scheme failed."""
ANSWERED = {"total": ("h", "v", "vorticity"), "time": ("h", "v", "vorticity"),
            "slow": ("vorticity", "h", "v")}  # fmt: skip
"""For each kind of error the field that steppers are ranked by: the first one there is."""
BEST, TIE = "★ ", "≈ "
"""Marks of the cheapest row for a target, and of those that cannot be told from it."""


def cost(row: Row) -> float:
    """Time that rows are ranked by [s]."""
    return row.cost


def candidates(rows: Iterable[Row], metric: Metric) -> list[Row]:
    """Rows that may be compared: completed, meant as a setting, with an error."""
    return [row for row in rows if row.compared and math.isfinite(row.error(metric))]


def with_cost(rows: Iterable[Row], metric: Metric, cost: Cost = cost) -> list[Row]:
    """Rows that may be compared, and that have a cost."""
    return [row for row in candidates(rows, metric) if 0.0 < cost(row) < math.inf]


def pareto(rows: Iterable[Row], metric: Metric, cost: Cost = cost, gain: float = GAIN) -> list[Row]:
    """Rows that no other row beats in both error and cost, by rising cost.

    Of rows equal in both the first stays.  A row whose error is smaller than that of a cheaper
    one by less than a part `gain` of it is left out: it costs more for nothing.
    """
    ordered = sorted(with_cost(rows, metric, cost), key=lambda r: (cost(r), r.error(metric)))
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
    """The cheapest row within the target error; the longest step where none is timed."""
    good = [row for row in candidates(rows, metric) if row.error(metric) <= target]
    timed = [row for row in good if row.timed]
    return min(timed, key=cost) if timed else max(good, key=lambda row: row.dt, default=None)


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
class Ranking:
    """Who reaches which error at which cost, on one mesh."""

    where: str
    """For example "williamson5, ne16 np4"."""
    metric: Metric
    targets: list[float]
    """Falling."""
    lines: list[tuple[Curve, list[Row | None]]]
    """For each stepper the cheapest row for each target, and the row of its smallest error."""
    plateau: Plateau | None = None
    notes: list[str] = field(default_factory=list)
    """What to keep in mind."""

    @property
    def rows(self) -> list[list[Row | None]]:
        """Rows of the table, for each stepper."""
        return [cells for _, cells in self.lines]

    def winners(self, target: int) -> list[Row]:
        """The cheapest row for a target, by its number, and those that cannot be told from it."""
        found = [row for cells in self.rows if (row := cells[target]) is not None and row.timed]
        found.sort(key=cost)
        return [row for row in found if not told_apart(found[0], row)]

    def next_after(self, target: int) -> Row | None:
        """The cheapest row for a target that is dearer than the winners."""
        best = self.winners(target)
        rows = (row for cells in self.rows if (row := cells[target]) is not None and row.timed)
        return min((row for row in rows if row not in best), key=cost, default=None)

    def label(self, row: Row) -> str:
        """The stepper of a row as its line has it."""
        return next(curve.label for curve, _ in self.lines if row in curve.rows)

    @property
    def clock(self) -> str:
        """Name of the time that steppers are ranked by; empty where none was taken."""
        rows = (row for cells in self.rows for row in cells if row is not None)
        return next((row.clock for row in rows if row.timed), "")

    @property
    def smallest_error(self) -> float:
        """That of any stepper."""
        return min(cells[-1].error(self.metric) for cells in self.rows if cells[-1] is not None)

    @property
    def answered(self) -> int | None:
        """The target of the headline: the smallest that two steppers reach, or else one."""
        reached = [sum(row is not None for row in cells) for cells in zip(*self.rows, strict=True)]
        for fewest in (2, 1):
            if told := [i for i, count in enumerate(reached[:-1]) if count >= fewest]:
                return told[-1]
        return None

    @property
    def heads(self) -> list[str]:
        """Of the table."""
        return ["stepper", *(f"≤ {words.level(t)}" for t in self.targets), "smallest error"]

    @cached_property
    def body(self) -> list[list[str]]:
        """The lines of the table: names, then step, cost and error, marked where the cheapest."""
        winners = [*map(self.winners, range(len(self.targets))), []]
        return [
            [curve.label, *(self._cell(*pair) for pair in zip(cells, winners, strict=True))]
            for curve, cells in self.lines
        ]

    def _cell(self, row: Row | None, best: list[Row]) -> str:
        if row is None:
            return words.NOTHING
        mark = "" if row not in best else BEST if len(best) == 1 else TIE
        seconds = f" {words.seconds(row.cost)}," if row.timed else ""
        return f"{mark}{words.step(row.dt)},{seconds} {words.error(row.error(self.metric))}"

    @property
    def headline(self) -> str:
        """One sentence on the cheapest stepper."""
        return prose("headline", self)

    @property
    def caption(self) -> str:
        """How to read the table."""
        return prose("caption", self, BEST, TIE)


def rankings(
    rows: Sequence[Row], found: Sequence[Metric], where: str, own: float = math.nan,
    levels: Sequence[float] = (),
) -> list[Ranking]:  # fmt: skip
    """One for each kind of error that some row has, the one to rank by first.

    That is the first of total, time and slow-flow error, but the slow one where the depth
    saturates.  rows: of one mesh.  own: time error of the converged run that time errors are taken
    against.  levels: requested targets; no run counts for a target below own.
    """
    by_name = {(metric.kind, metric.field): metric for metric in found}
    chosen = (
        next((by_name[kind, field] for field in order if (kind, field) in by_name), None)
        for kind, order in ANSWERED.items()
    )
    made = [_ranking(rows, metric, where, own, levels) for metric in chosen if metric is not None]
    slow = any(metric.kind == "slow" for metric in found)
    for ranking in made:
        if ranking.plateau:
            ranking.notes.append(prose("plateau", ranking.metric, ranking.plateau, slow))
    saturates = any(of.plateau is not None and not of.plateau.everywhere for of in made)
    made.sort(key=lambda ranking: ranking.metric.kind != "slow" and saturates)
    return [ranking for ranking in made if ranking.lines]


def _ranking(
    rows: Sequence[Row], metric: Metric, where: str, own: float, levels: Sequence[float]
) -> Ranking:
    drawn = [curve for curve in curves(rows) if smallest(curve.rows, metric) is not None]
    # the check of the converged run is on its depth
    resolved = own if (metric.kind, metric.field) == ("time", "h") and own > 0.0 else 0.0
    wanted = sorted(levels, reverse=True)
    wanted = wanted or targets([curve.rows for curve in drawn], metric, resolved)
    lines: list[tuple[Curve, list[Row | None]]] = []
    for curve in drawn:
        cells = [cheapest(curve.rows, metric, t) if t >= resolved else None for t in wanted]
        lines.append((curve, [*cells, smallest(curve.rows, metric)]))
    lines.sort(key=lambda line: [row.cost if row and row.timed else math.inf for row in line[1]])
    flat = plateau(rows, metric) if metric.field == "h" and metric.kind != "slow" else None
    notes = [prose("unresolved", wanted[-1], own)] if wanted and wanted[-1] < resolved else []
    return Ranking(where, metric, wanted, lines, flat, notes)


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
    each = [[r for r in long if r.stepper == name] for name in {row.stepper for row in long}]
    told = [part for part in each if _span(r.dt for r in part) >= RANGE]
    flat = [part for part in told if _span(r.error(metric) for r in part) <= RANGE]
    if 2 * len(flat) <= len(told):
        return None
    members = [row for row in rows if any(row in part for part in flat)]
    lowest, highest = (f(members, key=lambda r: r.error(metric)) for f in (min, max))
    shortest, longest = (f(members, key=lambda r: r.dt) for f in (min, max))
    everywhere = best.error(metric) >= BELOW * lowest.error(metric)
    return Plateau(lowest, highest, shortest, longest, best, everywhere)


def _span(values: Iterable[float]) -> float:
    """Largest value over the smallest."""
    found = list(values)
    return max(found) / min(found) if min(found) > 0.0 else math.inf


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

    @property
    def sources(self) -> dict[str, Row]:
        """The rows by what they are."""
        of = {"smallest": self.best, "converged in time": self.converged, BASELINE: self.baseline}
        return {name: row for name, row in of.items() if row is not None}


def threshold(rows: Iterable[Row], metric: Metric) -> Threshold | None:
    """Up to which error nothing is lost, among rows of one mesh; None where no row has one.

    The largest of SLACK times the smallest error that any stepper reaches, SLACK times the
    error of the run converged in time, which no step can be blamed for, and the error of the
    baseline stepper at its largest completed step: who is as good as the explicit scheme at the
    step that one would run it with has lost nothing (Evans, Taylor & Drake 2010 compare so).
    """
    rows = list(rows)
    best = smallest(rows, metric)
    if best is None:
        return None
    explicit = [row for row in candidates(rows, metric) if row.stepper == BASELINE]
    base = max(explicit, key=lambda row: row.dt, default=None)
    exact = [r for r in rows if r.role == "converged" and math.isfinite(r.error(metric))]
    converged = min(exact, key=lambda row: row.dt, default=None)
    values = [SLACK * row.error(metric) for row in (best, converged) if row is not None]
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
