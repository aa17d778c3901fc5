"""All that a page says on a sweep, ready for a template, in HTML or in Markdown."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from numbers import Real
from typing import Any

from xarray import Dataset

from swe_sphere.studies.report import words
from swe_sphere.studies.report.answer import Ranking, rankings
from swe_sphere.studies.report.diagrams import Diagram, diagrams, error_diagrams
from swe_sphere.studies.report.palette import curves
from swe_sphere.studies.report.rows import MADE_FOR_OTHERS, Metric, Row, metrics, read_rows
from swe_sphere.studies.report.table import LargestSteps, how_it_ended, largest_steps
from swe_sphere.studies.sweep.sweep_plan import SweepPlan


@dataclass(frozen=True)
class OneMesh:
    """One mesh of a scene."""

    name: str
    """For file names and anchors."""
    title: str
    rows: list[Row]
    rankings: list[Ranking]
    """The one to rank by first."""
    errors: list[tuple[Metric, list[Diagram]]]
    """Figures of each error, that of the first ranking first."""
    diagrams: list[Diagram]
    losses: LargestSteps | None
    failures: list[tuple[Row, str]]
    """Runs that did not reach their end, and what to say on them."""


@dataclass(frozen=True)
class Section:
    """The sweep of one scene."""

    name: str
    """For file names and anchors."""
    title: str
    scene: str
    rows: list[Row]
    metrics: list[Metric]
    meshes: list[OneMesh]
    attributes: Mapping[str, Any]
    """Of the dataset."""

    @property
    def compared(self) -> list[Row]:
        """The rows that stand for a setting."""
        return [row for row in self.rows if row.compared]

    @property
    def headline(self) -> str:
        """One sentence for the top of a page."""
        told = [mesh.rankings[0].headline for mesh in self.meshes if mesh.rankings]
        return told[0] if told else f"No run of {self.scene} has an error that could be compared."


def sweep_rankings(
    dataset: Dataset, metric: Metric | None = None, levels: Sequence[float] = ()
) -> list[Ranking]:
    """The ranking to go by for each mesh of a sweep: its headline and its table.

    metric: the error to rank by; None: the one that tells most.  levels: target errors, none: round
    ones.  Raises ConfigError if the dataset is not one of a sweep.
    """
    own = _converged_error(dataset)
    return [
        ranking
        for where, rows in _meshes(read_rows(dataset))
        for ranking in rankings(rows, [metric] if metric else metrics(rows), where, own, levels)[:1]
    ]


def search_rankings(dataset: Dataset, plan: SweepPlan) -> list[Ranking]:
    """Rankings by the error that a plan has searched for, one for each mesh."""
    if not dataset.sizes["report_day"]:
        return []
    tried = dataset.isel(run=dataset["role"].values == "target")
    day, kind = float(dataset["report_day"].values[-1]), plan.target_kind
    total = dataset["error"].sel(kind="total", field=plan.target_field)
    if kind == "auto":
        kind = "total" if bool(total.notnull().any()) else "time"
    field = "vorticity" if kind == "slow" else plan.target_field
    metric = Metric(kind, field, plan.target_norm, day)
    return sweep_rankings(tried, metric, [plan.target_error or math.inf])


def read_sections(datasets: Dataset | Mapping[str, Dataset]) -> list[Section]:
    """One section for each dataset.

    Raises ConfigError if one of them is not the dataset of a sweep.
    """
    if isinstance(datasets, Dataset):
        datasets = {str(datasets.attrs["scene"]): datasets}
    return [_section(name, dataset) for name, dataset in datasets.items()]


def _meshes(rows: Sequence[Row]) -> list[tuple[str, list[Row]]]:
    """The rows of a scene by what they are called: the scene and the mesh."""
    told = {row.mesh for row in rows if row.role not in MADE_FOR_OTHERS}
    found: dict[str, list[Row]] = {}
    for row in rows:
        if row.mesh in told:
            found.setdefault(f"{row.scene}, {row.mesh}", []).append(row)
    return [*found.items()]


def _converged_error(dataset: Dataset) -> float:
    """Time error of the run that time errors are taken against; NaN where it is not known."""
    return float(dataset.attrs.get("converged_check", math.nan))


def _section(name: str, dataset: Dataset) -> Section:
    rows, own = read_rows(dataset), _converged_error(dataset)
    return Section(
        name=_slug(name),
        title=name,
        scene=dataset.attrs["scene"],
        rows=rows,
        metrics=metrics(rows),
        meshes=[_mesh(where, members, own) for where, members in _meshes(rows)],
        attributes=dataset.attrs,
    )


def _mesh(where: str, rows: list[Row], own: float) -> OneMesh:
    found = metrics(rows)
    ranked = rankings(rows, found, where, own)
    first = [ranking.metric for ranking in ranked[:1]]
    errors = [(m, error_diagrams(rows, m)) for m in dict.fromkeys([*first, *found])]
    names = {row.number: curve.label for curve in curves(rows) for row in curve.rows}
    return OneMesh(
        name=_slug(rows[0].mesh),
        title=where,
        rows=rows,
        rankings=ranked,
        errors=[(metric, drawn) for metric, drawn in errors if drawn],
        diagrams=diagrams(rows),
        losses=largest_steps(rows, found),
        failures=[
            (row, f"{names[row.number]} at {words.step(row.dt)}, {how_it_ended(row)}")
            for row in rows
            if not row.completed
        ],
    )


def attribute(value: Any) -> str:
    """An attribute of a dataset as it is shown."""
    with suppress(ValueError):
        value = json.loads(value) if isinstance(value, str) else value
    if isinstance(value, dict):
        return ", ".join(f"{name} {attribute(part)}" for name, part in value.items())
    return f"{value:.4g}" if isinstance(value, Real) else str(value)


def _slug(text: str) -> str:
    """A text as a part of file names and anchors."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")
