"""The runs of a sweep as a table of pandas, and which setting is best.

Only runs that were measured count, never anything between them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from xarray import Dataset

from swe_sphere.errors import ConfigError
from swe_sphere.studies import words
from swe_sphere.studies.pages import prose
from swe_sphere.studies.sweep.record import FIELDS, UNITS, WORDS

COMPARED = ("grid", "target")
"""Roles of runs that stand for a setting; the others were made to find limits and references."""
NUMBERS = ("wall_seconds", "cpu_seconds", "spread", *UNITS)
"""Numbers of a run, beside those of custom diagnostics."""
ERROR = ("kind", "field", "norm", "report_day")
"""Dimensions of the errors of a run, as `Metric` has them."""

KINDS = {"total": "total error", "time": "time error", "slow": "slow-flow error"}
SYMBOLS = {"l1": "l1", "l2": "l2", "linf": "l∞"}

REPEATABLE = 0.03
"""Times are no better known than this, relative to themselves."""
TIMED_ONCE = 0.1
"""Relative uncertainty of the time of a run that was timed once."""
LINES = ("-", "--", ":", "-.")
"""Styles of the variants of a stepper."""
VARIANT = ("preconditioner", "precision", "device", "settings")
"""Settings that distinguish the curves of one stepper."""
GAIN = 0.01
"""A dearer run whose error is smaller by less than this part is not on the Pareto front."""
MOST_TARGETS = 5
SLACK = 1.1
BASELINE = "leapfrog"
FAILED = ("unstable", "solver-failed")
"""Status of runs whose scheme failed."""
ANSWERED = {"slow": ("vorticity", "h", "v"), "total": ("h", "v", "vorticity"),
            "time": ("h", "v", "vorticity")}  # fmt: skip
"""Kinds of error in the order of preference, each with the fields that steppers are ranked by: the
first available one. Depth does not rank where the initial state sheds gravity waves, which long
steps damp."""
BEST, TIE = "★ ", "≈ "
"""Marks of the cheapest run for a target, and of those that cannot be told from it."""


@dataclass(frozen=True)
class Metric:
    """One of the errors of a run; the name of its column."""

    kind: str
    """time: against a converged run of the same mesh; total: against the exact solution or a
    reference; slow: of the slow flow alone."""
    field: str
    norm: str
    day: float
    """When, in days."""

    @property
    def symbol(self) -> str:
        """Symbol of the error, such as l2(h)."""
        return f"{SYMBOLS.get(self.norm, self.norm)}({self.field})"

    @property
    def kind_title(self) -> str:
        """Name of the kind of error, such as "total error"."""
        return KINDS.get(self.kind, self.kind)

    @property
    def label(self) -> str:
        """Label of an axis, such as "l2(h), total error at day 15"."""
        return f"{self.symbol}, {self.kind_title} at day {self.day:g}"

    @property
    def name(self) -> str:
        """Part of the names of files and columns."""
        return f"{self.kind}_{self.norm}_{self.field}_day{self.day:g}"


def read_runs(dataset: Dataset) -> pd.DataFrame:
    """Variables and errors of each run, numbered from 1; columns of errors are a `Metric` each.

    Further columns: cost: time that runs are ranked by [s], NaN where none was taken; least, most:
    the shortest and the longest time that cannot be told from it; compared: whether a run reached
    its end and stands for a setting one could choose; ended: how it ended, in words; curve, line:
    label and style of the curve it belongs to; multiples of limits, and counts a step.

    Raises ConfigError if the dataset is not one of a sweep.
    """
    if missing := [n for n in (*WORDS, *NUMBERS, "error") if n not in dataset]:
        raise ConfigError(f"this dataset is not one of a sweep: it has no {missing[0]}")
    errors = dataset["error"].transpose("run", *ERROR)
    which = [Metric(*of) for of in product(*(errors[name].values.tolist() for name in ERROR))]
    values = errors.where(np.isfinite(errors)).values.reshape(dataset.sizes["run"], len(which))
    variables = {str(n): of.values for n, of in dataset.items() if of.dims == ("run",)}
    columns: dict[Any, Any] = variables | dict(zip(which, values.T, strict=True))
    runs = pd.DataFrame(columns, pd.RangeIndex(1, dataset.sizes["run"] + 1))
    runs = runs.assign(**_derived(runs), curve="", line="")
    for _, members in runs.groupby(["mesh", "stepper"]):
        _name_curves(runs, members)
    return runs


def _derived(runs: pd.DataFrame) -> dict[str, Any]:
    """Columns that follow from the variables of a dataset."""
    on_cpu = runs["device"] == "cpu"
    cost = runs["cpu_seconds"].where(on_cpu, runs["wall_seconds"])
    spread = runs["spread"].where(np.isfinite(runs["spread"]))
    known = 1.0 + spread.clip(lower=REPEATABLE).fillna(TIMED_ONCE)
    completed = runs["status"] == "completed"
    told = completed | (runs["reason"] == "")
    limits = runs[["gravity_limit", "advective_limit", "steps"]]
    gravity, advective, steps = limits.where(limits > 0.0).T.values
    meshes = (
        f"ne{ne:.0f} np{points:.0f}{'' if stretch == 1.0 else f', stretched {stretch:g}'}"
        for ne, points, stretch in runs[["ne", "np", "stretch"]].itertuples(False)
    )
    return dict(
        number=runs.index, cost=cost, timed=np.isfinite(cost), least=cost / known,
        most=cost * known, clock=np.where(on_cpu, "CPU time", "wall time"), completed=completed,
        compared=completed & runs["role"].isin(COMPARED),
        ended=runs["status"].where(told, runs["status"] + ": " + runs["reason"]),
        mesh=[*meshes],
        gravity_multiple=runs["dt"] / gravity, advective_multiple=runs["dt"] / advective,
        newton_a_step=runs["newton_iterations"] / steps,
        krylov_a_step=runs["krylov_iterations"] / steps,
    )  # fmt: skip


def _name_curves(runs: pd.DataFrame, members: pd.DataFrame) -> None:
    """Set label and style of the runs of one stepper on one mesh."""
    variants = members[[*VARIANT]].astype(object)
    for name in VARIANT:  # a run that never began may not have noted its own
        if len(only := {*variants[name]} - {""}) == 1:
            variants[name] = only.pop()
    variants["preconditioner"] = variants["preconditioner"].replace("none", "no preconditioner")
    differing = variants.loc[:, variants.nunique() > 1].replace("", "default")
    labels = members["stepper"].str.cat([differing[name] for name in differing], sep=", ")
    places = {label: n for n, label in enumerate(sorted({*labels}))}
    runs.loc[members.index, "curve"] = labels
    runs.loc[members.index, "line"] = [LINES[places[label] % len(LINES)] for label in labels]


def metrics(runs: pd.DataFrame) -> list[Metric]:
    """Return the l2 error at the last known day of each kind and field, in the order of reports."""
    compared = runs[runs["compared"]]
    known = [of for of in runs if isinstance(of, Metric) and compared[of].notna().any()]
    last = {(of.kind, of.field): of for of in sorted(known, key=lambda of: of.day)
            if of.norm == "l2"}  # fmt: skip
    return [last[key] for key in product(KINDS, FIELDS) if key in last]


# --- the best


def candidates(runs: pd.DataFrame, metric: Metric) -> pd.DataFrame:
    """Runs that may be compared: completed, meant as a setting, with an error."""
    return runs[runs["compared"] & runs[metric].notna()]


def with_cost(runs: pd.DataFrame, metric: Metric) -> pd.DataFrame:
    """Runs that may be compared, and that have a cost."""
    found = candidates(runs, metric)
    return found[found["cost"].between(0.0, math.inf, inclusive="neither")]


def pareto(runs: pd.DataFrame, metric: Metric) -> pd.DataFrame:
    """Runs that no other run beats in both error and cost, by rising cost; of equal ones the first.

    A run must improve on the errors of all cheaper ones by `GAIN`.
    """
    found = with_cost(runs, metric).sort_values(["cost", metric], kind="stable")
    least = found[metric].cummin().shift(fill_value=math.inf)
    return found[found[metric] < (1.0 - GAIN) * least]


def smallest(runs: pd.DataFrame, metric: Metric) -> pd.Series | None:
    """The run with the smallest error; of equal ones the cheapest."""
    found = candidates(runs, metric).sort_values([metric, "cost"])
    return None if found.empty else found.iloc[0]


def cheapest(runs: pd.DataFrame, metric: Metric, target: float) -> pd.Series | None:
    """The cheapest run within the target error; the longest step where none is timed."""
    good = candidates(runs, metric)
    good = good[good[metric] <= target].sort_values("dt", ascending=False, kind="stable")
    if good["timed"].any():
        good = good.sort_values("cost", kind="stable")
    return None if good.empty else good.iloc[0]


def targets(best: Iterable[float], resolved: float = 0.0) -> list[float]:
    """Round errors, falling: from one that all of these reach to the smallest that one does.

    Powers of ten, and three times these where that makes no more than MOST_TARGETS; of too many
    the smallest are left out.  resolved: errors below are not known well enough to be targets.
    """
    best = [error for error in best if error > 0.0]
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


@dataclass(frozen=True, eq=False)
class Ranking:
    """Who reaches which error at which cost, on one mesh."""

    where: str
    """For example "williamson5, ne16 np4"."""
    metric: Metric
    targets: list[float]
    """Falling."""
    lines: dict[str, list[pd.Series | None]]
    """For each curve the cheapest run for each target, and the run of its smallest error."""
    note: str = ""
    """What to keep in mind."""

    def _timed(self, target: int) -> list[pd.Series]:
        """The cheapest run of each curve for a target, by rising cost."""
        found = [of for row in self.lines.values() if (of := row[target]) is not None and of.timed]
        return sorted(found, key=lambda run: run.cost)

    def winners(self, target: int) -> list[pd.Series]:
        """The cheapest run for a target, by its number, and those that cannot be told from it."""
        found = self._timed(target)
        return [run for run in found if run.least <= found[0].most]

    def next_after(self, target: int) -> pd.Series | None:
        """The cheapest run for a target that is dearer than the winners."""
        found = self._timed(target)
        return next((run for run in found if run.least > found[0].most), None)

    @property
    def clock(self) -> str:
        """Name of the time that steppers are ranked by; empty where none was taken."""
        runs = (run for row in self.lines.values() for run in row if run is not None)
        return next((run.clock for run in runs if run.timed), "")

    @property
    def answered(self) -> int | None:
        """The target of the headline: the smallest that two steppers reach, or else one."""
        reached = [
            sum(of is not None for of in row) for row in zip(*self.lines.values(), strict=True)
        ]
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
        best = [{run.number for run in self.winners(i)} for i in range(len(self.targets))]
        return [[curve, *map(self._cell, row, [*best, set()])] for curve, row in self.lines.items()]

    def _cell(self, run: pd.Series | None, best: set[int]) -> str:
        if run is None:
            return words.NOTHING
        mark = "" if run.number not in best else BEST if len(best) == 1 else TIE
        seconds = f" {words.seconds(run.cost)}," if run.timed else ""
        return f"{mark}{words.step(run['dt'])},{seconds} {words.error(run[self.metric])}"

    @property
    def headline(self) -> str:
        """One sentence on the cheapest stepper."""
        return prose("headline", self)

    @property
    def caption(self) -> str:
        """How the table is to be read."""
        return prose("caption", self, BEST, TIE)


def rankings(
    runs: pd.DataFrame, found: Sequence[Metric], where: str, own: float = math.nan,
    levels: Sequence[float] = (),
) -> list[Ranking]:  # fmt: skip
    """A ranking for each kind of error: the first is the one to go by.

    runs: of one mesh.  where: name of scene and mesh.  own: error in time of the converged run;
    smaller targets are left out.  levels: the targets; none: round ones that steppers reach.
    """
    by_name = {(metric.kind, metric.field): metric for metric in found}
    curves, made = dict(iter(runs.groupby("curve"))), []
    for kind, order in ANSWERED.items():
        metric = next((by_name[kind, of] for of in order if (kind, of) in by_name), None)
        if metric is None:
            continue
        best = {name: smallest(of, metric) for name, of in curves.items()}
        reached = {name: run for name, run in best.items() if run is not None}
        # the check of the converged run is on its depth
        resolved = own if (kind, metric.field) == ("time", "h") and own > 0.0 else 0.0
        wanted = sorted(levels, reverse=True)
        wanted = wanted or targets((run[metric] for run in reached.values()), resolved)
        cells = {
            name: [cheapest(curves[name], metric, t) if t >= resolved else None for t in wanted]
            + [run]
            for name, run in reached.items()
        }
        costs = {
            name: [run.cost if run is not None and run.timed else math.inf for run in row]
            for name, row in cells.items()
        }
        lines = {name: cells[name] for name in sorted(cells, key=costs.__getitem__)}
        note = prose("unresolved", wanted[-1], own) if wanted and wanted[-1] < resolved else ""
        if lines:
            made.append(Ranking(where, metric, wanted, lines, note))
    return made


def threshold(runs: pd.DataFrame, metric: Metric) -> float:
    """Up to which error nothing is lost, among runs of one mesh; -inf where no run has one.

    The largest of SLACK times the smallest error that any stepper reaches, SLACK times the
    error of the run converged in time, which no step can be blamed for, and the error of the
    baseline stepper at its largest completed step: who is as good as the explicit scheme at the
    step that one would run it with has lost nothing (Evans, Taylor & Drake 2010 compare so).
    """
    compared = candidates(runs, metric).sort_values("dt", kind="stable")
    exact = runs[(runs["role"] == "converged") & runs[metric].notna()].sort_values("dt")
    slack = [compared[metric].min(), *exact[metric].head(1)]
    base = compared.loc[compared["stepper"] == BASELINE, metric].tail(1)
    return -math.inf if compared.empty else max([*(SLACK * error for error in slack), *base])


def largest_step(runs: pd.DataFrame, metric: Metric, limit: float) -> pd.Series | None:
    """The run with the largest step up to which the error stays within a limit.

    runs: of one stepper on one mesh.  Steps count from the smallest measured one up to the first
    that fails or whose error exceeds the limit: a longer one beyond it that happens to have a
    small error does not count.  A run that was cut short or refused says nothing either way.
    None if the smallest step already exceeds it.
    """
    runs = runs.sort_values(["dt", metric], ascending=[True, False], na_position="first")
    known = runs["compared"] & runs[metric].notna()
    lost = (runs["status"].isin(FAILED) | (known & (runs[metric] > limit))).cummax()
    good = runs[known & ~lost]
    return None if good.empty else good.iloc[-1]
