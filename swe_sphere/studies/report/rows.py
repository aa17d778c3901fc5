"""Rows of a sweep: one run each, read from its dataset."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from xarray import Dataset

from swe_sphere.errors import ConfigError
from swe_sphere.studies.sweep.dataset import UNITS, WORDS

COMPARED = ("grid", "target")
"""Roles of runs that stand for a setting; the others were made to find limits and references."""
MADE_FOR_OTHERS = ("converged",)
"""Roles of runs that say nothing on a stepper."""
NUMBERS = ("wall_seconds", "cpu_seconds", "spread", *UNITS)
"""Of a row, beside the user's own diagnostics."""

KINDS = {"total": "total error", "time": "time error", "slow": "slow-flow error"}
SYMBOLS = {"l1": "l1", "l2": "l2", "linf": "l∞"}
QUANTITIES = {"h": "depth", "v": "wind", "vorticity": "vorticity"}

REPEATABLE = 0.03
"""Times are no better known than this, relative to themselves."""
TIMED_ONCE = 0.1
"""Uncertainty of the time of a run that was timed once, likewise."""


@dataclass(frozen=True)
class Metric:
    """Which of the errors of a row is meant."""

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
    def title(self) -> str:
        """For example "total error, depth"."""
        return f"{self.kind_title}, {QUANTITIES.get(self.field, self.field)}"

    @property
    def label(self) -> str:
        """For example "l2(h), total error at day 15"."""
        return f"{self.symbol}, {self.kind_title} at day {self.day:g}"

    @property
    def name(self) -> str:
        """For file and column names."""
        return f"{self.kind}_{self.norm}_{self.field}_day{self.day:g}"


@dataclass(frozen=True, eq=False)
class Row:
    """One run: its words and numbers are attributes, NaN where there is none."""

    number: int
    """Position in the dataset, from 1."""
    values: Mapping[str, Any]
    errors: Mapping[Metric, float]
    """Those that are defined."""

    def __getattr__(self, name: str) -> Any:
        values = self.__dict__.get("values", {})  # none yet while the row is being copied
        if name not in values:
            raise AttributeError(name)
        return values[name]

    @property
    def clock(self) -> str:
        """Name of the time that runs are ranked by."""
        return "CPU time" if self.device == "cpu" else "wall time"

    @property
    def cost(self) -> float:
        """Shortest such time of its steps [s]; NaN where none was taken."""
        return float(self.cpu_seconds if self.device == "cpu" else self.wall_seconds)

    @property
    def timed(self) -> bool:
        """Whether it has a cost."""
        return math.isfinite(self.cost)

    @property
    def interval(self) -> tuple[float, float]:
        """Shortest and longest time that cannot be told from the cost [s]."""
        known = max(REPEATABLE, self.spread) if math.isfinite(self.spread) else TIMED_ONCE
        return self.cost / (1.0 + known), self.cost * (1.0 + known)

    @property
    def completed(self) -> bool:
        """Whether the run reached its end."""
        return bool(self.status == "completed")

    @property
    def compared(self) -> bool:
        """Whether the run reached its end and stands for a setting one could choose."""
        return self.completed and self.role in COMPARED

    @property
    def mesh(self) -> str:
        """For example "ne16 np4, stretched 4"."""
        stretched = f", stretched {self.stretch:g}" if self.stretch != 1.0 else ""
        return f"ne{self.ne:.0f} np{self.np:.0f}{stretched}"

    @property
    def evaluations(self) -> float:
        """Number of right-hand sides and Jacobian products: work on any machine."""
        return float(self.rhs_evaluations + self.tangent_evaluations)

    @property
    def gravity_multiple(self) -> float:
        """Step over the gravity-wave limit."""
        return _ratio(self.dt, self.gravity_limit)

    @property
    def advective_multiple(self) -> float:
        """Step over the advective limit."""
        return _ratio(self.dt, self.advective_limit)

    def error(self, metric: Metric) -> float:
        """That error, NaN where it is not defined."""
        return self.errors.get(metric, math.nan)

    def per_step(self, count: str) -> float:
        """A count, by its name, for each step."""
        return _ratio(float(getattr(self, count)), self.steps)


def _ratio(value: float, unit: float) -> float:
    return value / unit if unit > 0.0 else math.nan


def read_rows(dataset: Dataset) -> list[Row]:
    """The rows of a sweep's dataset, in its order.

    Raises ConfigError if the dataset is not one of a sweep.
    """
    if missing := [n for n in (*WORDS, *NUMBERS, "error") if n not in dataset]:
        raise ConfigError(f"this dataset is not one of a sweep: it has no {missing[0]}")
    columns = {str(n): of.values.tolist() for n, of in dataset.items() if of.dims == ("run",)}
    return [
        Row(i + 1, {name: of[i] for name, of in columns.items()}, errors)
        for i, errors in enumerate(_errors(dataset))
    ]


def _errors(dataset: Dataset) -> list[dict[Metric, float]]:
    found: list[dict[Metric, float]] = [{} for _ in range(dataset.sizes["run"])]
    axes = ("run", "kind", "field", "norm", "report_day")
    errors = dataset["error"].transpose(*axes).to_series()
    for (i, *which), value in errors[np.isfinite(errors)].items():
        found[i][Metric(*which)] = float(value)
    return found


def metrics(rows: Iterable[Row]) -> list[Metric]:
    """For each kind and field, in the order of the report, the l2 error at the last day given."""
    last: dict[tuple[str, str], Metric] = {}
    for metric in {m for row in rows if row.compared for m in row.errors if m.norm == "l2"}:
        key = (metric.kind, metric.field)
        if key not in last or metric.day > last[key].day:
            last[key] = metric
    order = [(kind, quantity) for kind in KINDS for quantity in QUANTITIES]
    return [last[key] for key in order if key in last]


LINES = ("-", "--", ":", "-.")
"""Styles of the variants of a stepper (preconditioner, precision, device, settings)."""


@dataclass(frozen=True, eq=False)
class Curve:
    """Rows that differ in their step only, by rising step."""

    label: str
    stepper: str
    line: str
    rows: tuple[Row, ...]


def curves(rows: Iterable[Row]) -> list[Curve]:
    """Rows of one mesh as curves; a label says what tells it from the stepper's other curves."""
    rows = list(rows)
    names: set[str] = {row.stepper for row in rows}
    only = {name: _only([row for row in rows if row.stepper == name]) for name in names}
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        variant = (part or one for part, one in zip(_variant(row), only[row.stepper], strict=True))
        groups.setdefault((row.stepper, *variant), []).append(row)
    made = []
    for key, members in sorted(groups.items()):
        others = [other for other in sorted(groups) if other[0] == key[0]]
        label = ", ".join([key[0], *_difference(key, others)])
        line = LINES[others.index(key) % len(LINES)]
        made.append(Curve(label, key[0], line, tuple(sorted(members, key=lambda row: row.dt))))
    return made


def _variant(row: Row) -> tuple[str, ...]:
    return row.preconditioner, row.precision, row.device, row.settings


def _only(rows: list[Row]) -> tuple[str, ...]:
    """What stands for an empty part of a variant: a run that never began may not have noted it."""
    parts = [set(filter(None, values)) for values in zip(*map(_variant, rows), strict=True)]
    return tuple(part.pop() if len(part) == 1 else "" for part in parts)


PLAIN = {(1, "none"): "no preconditioner"}


def _difference(key: tuple[str, ...], others: list[tuple[str, ...]]) -> list[str]:
    return [
        PLAIN.get((i, part), part or "default")
        for i, part in enumerate(key)
        if i and len({other[i] for other in others}) > 1
    ]
