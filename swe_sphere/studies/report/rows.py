"""Rows of a sweep: one run each, read from its dataset."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from swe_sphere.errors import ConfigError

if TYPE_CHECKING:
    from xarray import Dataset

__all__ = ["COMPLETED", "KINDS", "MADE_FOR_OTHERS", "Metric", "Row", "metrics", "read_rows"]

COMPLETED = "completed"
REQUIRED = ("stepper", "dt", "status", "wall_seconds")
COMPARED = ("", "grid", "target")
"""Roles of runs that stand for a setting; the others were made to find limits and references."""
MADE_FOR_OTHERS = ("converged", "rhs-cost")
"""Roles of runs that say nothing on a stepper."""

KINDS = {"total": "total error", "time": "time error", "slow": "slow-flow error"}
SYMBOLS = {"l1": "l1", "l2": "l2", "linf": "l∞"}
QUANTITIES = {"h": "depth", "v": "wind", "vorticity": "vorticity"}


@dataclass(frozen=True)
class Metric:
    """Which of the errors of a row is meant."""

    kind: str
    """time: against a converged run of the same mesh; total: against the exact solution or a
    reference; slow: of the slow flow alone."""
    field: str
    norm: str
    day: float
    """The moment, in days."""

    @property
    def symbol(self) -> str:
        """For example l2(h)."""
        return f"{SYMBOLS.get(self.norm, self.norm)}({self.field})"

    @property
    def title(self) -> str:
        """For example "total error, depth"."""
        return f"{KINDS.get(self.kind, self.kind)}, {QUANTITIES.get(self.field, self.field)}"

    @property
    def label(self) -> str:
        """For example "l2(h), total error at day 15"."""
        return f"{self.symbol}, {KINDS.get(self.kind, self.kind)} at day {self.day:g}"

    @property
    def name(self) -> str:
        """For file and column names."""
        return f"{self.kind}_{self.norm}_{self.field}_day{self.day:g}"


@dataclass(frozen=True)
class Row:
    """One run; numbers that were not recorded are NaN, words empty."""

    number: int
    """Position in the dataset, from 1."""
    stepper: str
    dt: float
    status: str
    wall_seconds: float
    scene: str = ""
    preconditioner: str = ""
    precision: str = ""
    device: str = ""
    settings: str = ""
    role: str = ""
    reason: str = ""
    ne: float = math.nan
    np: float = math.nan
    stretch: float = math.nan
    days: float = math.nan
    steps: float = math.nan
    wall_spread: float = math.nan
    cpu_seconds: float = math.nan
    compile_seconds: float = math.nan
    setup_seconds: float = math.nan
    total_seconds: float = math.nan
    peak_memory: float = math.nan
    rhs_seconds: float = math.nan
    rhs_evaluations: float = math.nan
    tangent_evaluations: float = math.nan
    preconditioner_applications: float = math.nan
    newton_iterations: float = math.nan
    krylov_iterations: float = math.nan
    rejected_steps: float = math.nan
    gravity_limit: float = math.nan
    advective_limit: float = math.nan
    mass_drift: float = math.nan
    energy_drift: float = math.nan
    enstrophy_drift: float = math.nan
    walls: tuple[float, ...] = ()
    """Wall seconds of each repeat."""
    errors: Mapping[Metric, float] = field(default_factory=dict)
    """Those that are defined."""

    @property
    def completed(self) -> bool:
        """Whether the run reached its end."""
        return self.status == COMPLETED

    @property
    def compared(self) -> bool:
        """Whether the run reached its end and stands for a setting one could choose."""
        return self.completed and self.role in COMPARED

    @property
    def mesh(self) -> str:
        """For example "ne16 np4, stretched 4"."""
        parts = [f"{name}{value:.0f}" for name, value in (("ne", self.ne), ("np", self.np))
                 if math.isfinite(value)]  # fmt: skip
        stretched = math.isfinite(self.stretch) and self.stretch != 1.0
        return " ".join(parts) + (f", stretched {self.stretch:g}" if stretched else "")

    @property
    def equivalents(self) -> float:
        """CPU time in units of one right-hand side on the same mesh."""
        return self.cpu_seconds / self.rhs_seconds if self.rhs_seconds > 0.0 else math.nan

    @property
    def gravity_multiple(self) -> float:
        """Step over the gravity-wave limit."""
        return self.dt / self.gravity_limit if self.gravity_limit > 0.0 else math.nan

    @property
    def advective_multiple(self) -> float:
        """Step over the advective limit."""
        return self.dt / self.advective_limit if self.advective_limit > 0.0 else math.nan

    def error(self, metric: Metric) -> float:
        """That error, NaN where it is not defined."""
        return self.errors.get(metric, math.nan)

    def per_step(self, count: str) -> float:
        """A count, by its name, for each step."""
        return float(getattr(self, count)) / self.steps if self.steps > 0 else math.nan


WORDS = tuple(f.name for f in fields(Row) if f.type == "str")
NUMBERS = tuple(f.name for f in fields(Row) if f.type == "float")


def read_rows(dataset: Dataset) -> list[Row]:
    """The rows of a sweep's dataset, in its order.

    Raises ConfigError if the dataset is not one of a sweep.
    """
    if missing := [name for name in REQUIRED if name not in dataset]:
        raise ConfigError(f"this dataset is not one of a sweep: it has no {', '.join(missing)}")
    count = dataset.sizes.get("run", 0)
    columns: dict[str, list[object]] = {
        **{name: _words(dataset, name) for name in WORDS if name in dataset},
        **{name: _numbers(dataset, name).tolist() for name in NUMBERS if name in dataset},
    }
    walls, errors = _walls(dataset, count), _errors(dataset, count)
    return [
        Row(number=i + 1, walls=walls[i], errors=errors[i], **{k: v[i] for k, v in columns.items()})  # type: ignore[arg-type]
        for i in range(count)
    ]


def _words(dataset: Dataset, name: str) -> list[object]:
    values = dataset[name].values
    return ["" if value is None or value != value else str(value) for value in values]


def _numbers(dataset: Dataset, name: str) -> NDArray[np.float64]:
    return np.asarray(dataset[name].values, dtype=np.float64)


def _walls(dataset: Dataset, count: int) -> list[tuple[float, ...]]:
    if "wall" not in dataset:
        return [()] * count
    values = np.asarray(dataset["wall"].transpose("run", "repeat").values, dtype=np.float64)
    return [tuple(row[np.isfinite(row)].tolist()) for row in values]


def _errors(dataset: Dataset, count: int) -> list[dict[Metric, float]]:
    found: list[dict[Metric, float]] = [{} for _ in range(count)]
    if "error" not in dataset:
        return found
    axes = ("kind", "field", "norm", "report_day")
    values = dataset["error"].transpose("run", *axes).values
    labels = [dataset[axis].values.tolist() for axis in axes]
    for i, *where in np.argwhere(np.isfinite(values)):
        kind, quantity, norm, day = (names[j] for names, j in zip(labels, where, strict=True))
        metric = Metric(str(kind), str(quantity), str(norm), float(day))
        found[i][metric] = float(values[(i, *where)])
    return found


def metrics(rows: Iterable[Row], norm: str = "l2") -> list[Metric]:
    """For each kind and field, in the order of the report, the error at the last moment given."""
    last: dict[tuple[str, str], Metric] = {}
    for metric in {m for row in rows if row.compared for m in row.errors if m.norm == norm}:
        key = (metric.kind, metric.field)
        if key not in last or metric.day > last[key].day:
            last[key] = metric
    order = [(kind, quantity) for kind in KINDS for quantity in QUANTITIES]
    return [last[key] for key in order if key in last]
