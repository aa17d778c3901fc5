"""The runs of a sweep as a table of pandas, read from its dataset: a line each, by its number."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from xarray import Dataset

from swe_sphere.errors import ConfigError
from swe_sphere.studies.sweep.dataset import UNITS, WORDS
from swe_sphere.studies.sweep.record import FIELDS

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
"""What tells the curves of one stepper apart."""


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
        """For example l2(h)."""
        return f"{SYMBOLS.get(self.norm, self.norm)}({self.field})"

    @property
    def kind_title(self) -> str:
        """For example "total error"."""
        return KINDS.get(self.kind, self.kind)

    @property
    def label(self) -> str:
        """For example "l2(h), total error at day 15"."""
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
    """For each kind and field, in the order of the report, the l2 error at the last day known."""
    compared = runs[runs["compared"]]
    known = [of for of in runs if isinstance(of, Metric) and compared[of].notna().any()]
    last = {(of.kind, of.field): of for of in sorted(known, key=lambda of: of.day)
            if of.norm == "l2"}  # fmt: skip
    return [last[key] for key in product(KINDS, FIELDS) if key in last]
