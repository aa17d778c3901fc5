"""The runs of a sweep as a table of pandas, and which setting is best.

Only measured runs count; nothing is interpolated.
"""

import json
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
from swe_sphere.studies.sweep.record import COMPARED, FIELDS, REPEATABLE, UNITS, WORDS

ERROR = ("kind", "field", "norm", "report_day")
"""Dimensions of the errors of a run, in the order of the fields of `Metric`."""

KINDS = {"total": "total error", "time": "time error", "slow": "slow-flow error"}

TIMED_ONCE = 0.1
"""Relative uncertainty of the time of a run that was timed once."""
LINES = ("-", "--", ":", "-.")
"""Line styles of the variants of a stepper."""
VARIANT = ("preconditioner", "precision", "device", "settings")
"""Settings that distinguish the curves of one stepper."""
MOST_TARGETS = 5
BROKE_DOWN = ("unstable", "solver-failed")
"""Status of runs whose scheme failed."""
ANSWERED = {"slow": ("vorticity", "h", "v"), "total": ("h", "v", "vorticity"),
            "time": ("h", "v", "vorticity")}  # fmt: skip
"""Kinds of error in the order of preference, each with the fields that steppers are ranked by: the
first available one. Depth does not rank if the initial state sheds waves, which long steps damp."""
BEST, TIE = "★ ", "≈ "
"""Marks of the run that alone is the cheapest for a target, and of all runs of a tie."""


@dataclass(frozen=True)
class Metric:
    """One of the errors of a run; instances are labels of columns in the table of runs."""

    kind: str
    """time: relative to a converged run on the same mesh; total: relative to the exact solution or
    a reference; slow: error of the slow flow alone."""
    field: str
    norm: str
    day: float
    """Time [days]."""

    @property
    def symbol(self) -> str:
        """Symbol of the error, such as l2(h)."""
        is_slow = (self.kind, self.field) == ("slow", "vorticity")
        field = "potential vorticity" if is_slow else self.field
        return f"{self.norm.replace('linf', 'l∞')}({field})"

    @property
    def kind_title(self) -> str:
        """Name of the kind of error, such as "total error"."""
        return KINDS.get(self.kind, self.kind)

    @property
    def label(self) -> str:
        """Part of a caption, such as "l2(h), total error at day 15"."""
        return f"{self.symbol}, {self.kind_title} at day {self.day:g}"

    @property
    def name(self) -> str:
        """Part of the names of files."""
        return f"{self.kind}_{self.norm}_{self.field}_day{self.day:g}"


def read_runs(dataset: Dataset) -> pd.DataFrame:
    """Return variables and errors of each run, numbered from 1; labels of errors are `Metric`s.

    Further columns: cost: time that runs are ranked by [s], NaN if none was measured; least, most:
    the shortest and the longest time that cannot be distinguished from it; compared: whether a run
    reached the end of the last request and stands for a setting of users; ended: how it ended, in
    words; curve, line: label and style of its curve; multiples of limits, and counts per step.

    Raises ConfigError if the dataset is not one of a sweep.
    """
    needed = (*WORDS, "wall_seconds", "cpu_seconds", "spread", *UNITS, "error")
    if missing := [name for name in needed if name not in dataset]:
        raise ConfigError(f"this dataset is not one of a sweep: it has no {missing[0]}")
    errors = dataset["error"].transpose("run", *ERROR)
    which = [Metric(*of) for of in product(*(errors[name].values.tolist() for name in ERROR))]
    values = errors.where(np.isfinite(errors)).values.reshape(dataset.sizes["run"], len(which))
    variables = {str(n): of.values for n, of in dataset.items() if of.dims == ("run",)}
    columns: dict[Any, Any] = variables | dict(zip(which, values.T, strict=True))
    runs = pd.DataFrame(columns, pd.RangeIndex(1, dataset.sizes["run"] + 1))
    days = json.loads(dataset.attrs.get("plan", "{}")).get("days")
    known = runs["days_planned"] if days is None else [days]
    runs = runs.assign(**_derived(runs, known), curve="", line="")
    for _, members in runs.groupby(["mesh", "stepper"]):
        _name_curves(runs, members)
    return runs


def _derived(runs: pd.DataFrame, days: Iterable[float]) -> dict[str, Any]:
    """Return columns that follow from the variables of a dataset; days: of comparable runs."""
    on_cpu = runs["device"] == "cpu"
    cost = runs["cpu_seconds"].where(on_cpu, runs["wall_seconds"])
    spread = runs["spread"].where(np.isfinite(runs["spread"]))
    known = 1.0 + spread.clip(lower=REPEATABLE).fillna(TIMED_ONCE)
    completed = runs["status"] == "completed"
    unexplained = completed | (runs["reason"] == "")
    limits = runs[["gravity_limit", "advective_limit", "steps"]]
    gravity, advective, steps = limits.where(limits > 0.0).T.values
    meshes = (
        f"ne{ne:.0f} np{points:.0f}{'' if stretch == 1.0 else f', stretched {stretch:g}'}"
        for ne, points, stretch in runs[["ne", "np", "stretch"]].itertuples(False)
    )
    return dict(
        number=runs.index, cost=cost, timed=np.isfinite(cost), least=cost / known,
        most=cost * known, clock=np.where(on_cpu, "CPU time", "wall time"), completed=completed,
        compared=completed & runs["role"].isin(COMPARED) & runs["days_planned"].isin(days),
        ended=runs["status"].where(unexplained, runs["status"] + ": " + runs["reason"]),
        mesh=[*meshes],
        gravity_multiple=runs["dt"] / gravity, advective_multiple=runs["dt"] / advective,
        newton_a_step=runs["newton_iterations"] / steps,
        krylov_a_step=runs["krylov_iterations"] / steps,
    )  # fmt: skip


def _name_curves(runs: pd.DataFrame, members: pd.DataFrame) -> None:
    """Set label and style of the runs of one stepper on one mesh."""
    variants = members[[*VARIANT]].astype(object)
    for name in VARIANT[:3]:  # a run that never began may lack a value; no settings are a choice
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


def candidates(runs: pd.DataFrame, metric: Metric) -> pd.DataFrame:
    """Return comparable runs (column `compared` of `read_runs`) that have this error."""
    return runs[runs["compared"] & runs[metric].notna()]


def with_cost(runs: pd.DataFrame, metric: Metric) -> pd.DataFrame:
    """Return comparable runs that have a cost."""
    found = candidates(runs, metric)
    return found[found["cost"].between(0.0, math.inf, inclusive="neither")]


def smallest(runs: pd.DataFrame, metric: Metric) -> pd.DataFrame:
    """Return the run of each curve with the smallest error, by rising error and cost."""
    return candidates(runs, metric).sort_values([metric, "cost"]).drop_duplicates("curve")


def cheapest(runs: pd.DataFrame, metric: Metric, target: float) -> pd.DataFrame:
    """Return the cheapest run of each curve within the target error, by rising cost.

    A curve without timed runs contributes its longest step; such curves come last.
    """
    good = candidates(runs, metric)
    good = good[good[metric] <= target].sort_values("dt", ascending=False, kind="stable")
    return good.sort_values("cost", kind="stable").drop_duplicates("curve")


def targets(best: Iterable[float], resolved: float = 0.0) -> list[float]:
    """Return round errors, the largest first: from one that all reach to the smallest reached.

    They are powers of ten, and three times these if that gives at most MOST_TARGETS; of too many
    the smallest are omitted. best: smallest error of each curve. resolved: least possible target.
    """
    if not (best := [error for error in best if error > 0.0]):
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
    """Costs at which steppers reach errors on one mesh."""

    where: str
    """For example "williamson5, ne16 np4"."""
    metric: Metric
    targets: list[float]
    """Target errors, the largest first."""
    runs: pd.DataFrame
    """All runs on the mesh, by number."""
    table: pd.DataFrame
    """Numbers of the cheapest run of each curve for each target, and of the run with its
    smallest error; 0 where there is none."""
    note: str = ""
    """Note on the limits of the ranking; may be empty."""
    floor: float = 0.0
    """Error of the converged run to which the errors are relative; 0 if unknown."""

    def reached(self, target: int) -> pd.DataFrame:
        """Return the cheapest timed run of each curve for `targets[target]`, by rising cost."""
        found = self.runs.loc[self.table[target][self.table[target] > 0]]
        return found[found["timed"]].sort_values("cost", kind="stable")

    def winners(self, target: int) -> pd.DataFrame:
        """Return the cheapest run for `targets[target]`, and runs of indistinguishable cost."""
        found = self.reached(target)
        return found[found["least"] <= found["most"].head(1).max()]

    @property
    def clock(self) -> str:
        """Name of the time that ranks steppers; empty if no run was timed."""
        return next(iter(with_cost(self.runs, self.metric)["clock"]), "")

    @property
    def answered(self) -> int | None:
        """Index of the headline's target: the smallest that two curves reach, or else one."""
        counts = [(self.table[i] > 0).sum() for i in range(len(self.targets))]
        reached = [i for fewest in (1, 2) for i, count in enumerate(counts) if count >= fewest]
        return reached[-1] if reached else None

    @property
    def heads(self) -> list[str]:
        """Headings of the table."""
        return ["stepper", *(f"≤ {words.level(t)}" for t in self.targets), "smallest error"]

    @cached_property
    def body(self) -> list[list[str]]:
        """Lines of the table: names, then step, cost and error, with a mark on the cheapest."""
        best = [self.winners(i)["number"].tolist() for i in range(len(self.targets))]
        return [
            [str(curve), *map(self._cell, numbers, [*best, []])]
            for curve, numbers in zip(self.table.index, self.table.values.tolist(), strict=True)
        ]

    def _cell(self, number: int, best: list[int]) -> str:
        if number == 0:
            return words.NOTHING
        run = self.runs.loc[number]
        mark = "" if number not in best else BEST if len(best) == 1 else TIE
        seconds = f" {words.seconds(run['cost'])}," if run["timed"] else ""
        return f"{mark}{words.step(run['dt'])},{seconds} {words.error(run[self.metric])}"

    @property
    def headline(self) -> str:
        """One sentence on the cheapest stepper."""
        return prose("headline", self)

    @property
    def caption(self) -> str:
        """Explanation of the table."""
        return prose("caption", self, BEST, TIE)


def rankings(
    runs: pd.DataFrame, found: Sequence[Metric], where: str, levels: Sequence[float] = ()
) -> list[Ranking]:
    """Return a ranking for each kind of error: the first is the decisive one.

    runs: of one mesh. where: name of scene and mesh. levels: the targets; none: round ones that
    steppers reach. No run counts for a target below the error of the converged run.
    """
    by_name, made = {(metric.kind, metric.field): metric for metric in found}, []
    for kind, order in ANSWERED.items():
        metric = next((by_name[kind, of] for of in order if (kind, of) in by_name), None)
        if metric is None or (best := smallest(runs, metric)).empty:
            continue
        references = runs[(runs["role"] == "converged") & (kind != "total")]
        finest = references.groupby("settings")[metric].min()  # NaN does not count
        resolved = float(np.nan_to_num(finest.max()))
        wanted = sorted({*levels}, reverse=True) or targets(best[metric], resolved)
        columns = [cheapest(runs, metric, t) if t >= resolved else best.head(0) for t in wanted]
        table = pd.DataFrame({i: of.set_index("curve")["number"]
                              for i, of in enumerate([*columns, best])})  # fmt: skip
        table = table.fillna(0).astype(int)
        costs = table.apply(lambda numbers: numbers.map(runs["cost"])).fillna(math.inf)
        table = table.loc[costs.sort_values([*costs]).index]
        note = prose("unresolved", wanted[-1], resolved) if wanted and wanted[-1] < resolved else ""
        made.append(Ranking(where, metric, wanted, runs, table, note, resolved))
    return made
