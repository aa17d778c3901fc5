"""All that a page says on a sweep, ready for a template, in HTML or in Markdown."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from swe_sphere.studies.report import words
from swe_sphere.studies.report.answer import Ranking, rankings
from swe_sphere.studies.report.figures import Diagram, diagrams, error_diagrams
from swe_sphere.studies.report.largest_steps import largest_steps
from swe_sphere.studies.report.palette import curves
from swe_sphere.studies.report.rows import (
    MADE_FOR_OTHERS,
    MODELLED,
    REPEATABLE,
    Metric,
    Row,
    metrics,
    read_rows,
)
from swe_sphere.studies.report.table import Table, how_it_ended

if TYPE_CHECKING:
    from xarray import Dataset

__all__ = ["OneMesh", "Section", "read_sections", "sweep_rankings"]

HIDDEN = ("title", "scene", "plan")


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
    losses: Table | None
    failures: list[tuple[Row, str]]
    """Runs that did not reach their end, and what to say on them."""


@dataclass(frozen=True)
class Section:
    """One scene."""

    name: str
    """For file names and anchors."""
    title: str
    scene: str
    rows: list[Row]
    metrics: list[Metric]
    meshes: list[OneMesh]
    trust: list[str]
    """How far times and errors can be trusted."""
    made: list[tuple[str, str]]
    plan: str

    @property
    def headline(self) -> str:
        """One sentence for the top of a page."""
        told = [mesh.rankings[0].headline for mesh in self.meshes if mesh.rankings]
        return told[0] if told else f"No run of {self.scene} has an error that could be compared."


def sweep_rankings(dataset: Dataset) -> list[Ranking]:
    """The ranking to go by for each scene and mesh of a sweep: its headline and its table.

    Raises ConfigError if the dataset is not one of a sweep.
    """
    meshes = (mesh for section in read_sections(dataset) for mesh in section.meshes)
    return [mesh.rankings[0] for mesh in meshes if mesh.rankings]


def read_sections(
    datasets: Dataset | Mapping[str, Dataset], levels: Sequence[float] = ()
) -> list[Section]:
    """One section for each scene of each dataset; levels: target errors, none: round ones.

    Raises ConfigError if one of them is not the dataset of a sweep.
    """
    from xarray import Dataset

    if isinstance(datasets, Dataset):
        datasets = {str(datasets.attrs.get("scene", "")): datasets}
    found = []
    for name, dataset in datasets.items():
        rows = read_rows(dataset)
        scenes = list(dict.fromkeys(row.scene for row in rows)) or [name]
        for scene in scenes:
            label = name if len(scenes) == 1 and name else f"{name} {scene}".strip()
            members = [row for row in rows if row.scene == scene]
            found.append(_section(label, scene or label, members, dataset.attrs, levels))
    return found


def _section(
    name: str, scene: str, rows: list[Row], attributes: Mapping[Any, Any], levels: Sequence[float]
) -> Section:
    own = _float(attributes.get("converged_check"))
    meshes = list(dict.fromkeys(row.mesh for row in rows if row.role not in MADE_FOR_OTHERS))
    return Section(
        name=_slug(name) or "sweep",
        title=name or scene or "sweep",
        scene=scene,
        rows=rows,
        metrics=metrics(rows),
        meshes=[_mesh(scene, m, [r for r in rows if r.mesh == m], own, levels) for m in meshes],
        trust=[text for text in (_times(rows, attributes), _converged(attributes)) if text],
        made=_made(attributes),
        plan=_plan(attributes),
    )


def _mesh(scene: str, mesh: str, rows: list[Row], own: float, levels: Sequence[float]) -> OneMesh:
    found, where = metrics(rows), f"{scene}, {mesh}" if mesh else scene
    ranked = rankings(rows, found, where, own, levels)
    first = [ranking.metric for ranking in ranked[:1]]
    errors = [(m, error_diagrams(rows, m)) for m in dict.fromkeys([*first, *found])]
    names = {row.number: curve.label for curve in curves(rows) for row in curve.rows}
    failed = [row for row in rows if not row.completed]
    return OneMesh(
        name=_slug(mesh) or "mesh",
        title=where,
        rows=rows,
        rankings=[ranking for ranking in ranked if ranking.lines],
        errors=[(metric, drawn) for metric, drawn in errors if drawn],
        diagrams=diagrams(rows),
        losses=largest_steps(rows, found),
        failures=[
            (row, f"{names[row.number]} at {words.step(row.dt)}, {how_it_ended(row)}")
            for row in failed
        ],
    )


def _times(rows: Sequence[Row], attributes: Mapping[Any, Any]) -> str:
    """What steppers are ranked by, and how far that can be trusted."""
    compared = [row for row in rows if row.compared]
    spreads = [row.wall_spread for row in compared if math.isfinite(row.wall_spread)]
    repeats = max((len(row.walls) for row in compared), default=0)
    spread = f", which differ by up to {words.percent(max(spreads))}" if spreads else ""
    several = f"up to {repeats} repeats" if repeats else "repeats"
    wall = f"Wall times are medians of {several}{spread}"
    noise = _float(attributes.get("noise"))
    if math.isfinite(noise):
        wall += f"; right-hand sides timed in between spread over {words.percent(noise)}"
    if any(row.cost_kind == MODELLED for row in compared):
        return (
            "Steppers are ranked by modelled times: counted work at the lowest prices found during "
            f"the sweep, taken to be known to {words.percent(REPEATABLE)} or to what they still "
            f"fell by over the later half of the runs. {wall}."
        )
    return f"{wall}. Steppers are ranked by them, only where they differ by more."


def _converged(attributes: Mapping[Any, Any]) -> str:
    own = _float(attributes.get("converged_check"))
    step = _float(attributes.get("converged_dt"))
    if not math.isfinite(own) or not math.isfinite(step):
        return ""
    return (
        f"Time errors are against a run at {words.step(step)} on the same mesh, whose own time "
        f"error is about {words.error(own)} (Richardson): what is not well above that is noise."
    )


def _made(attributes: Mapping[Any, Any]) -> list[tuple[str, str]]:
    """What is known of how a dataset was made."""
    shown = ((str(name), value) for name, value in attributes.items() if name not in HIDDEN)
    return [(name.replace("_", " "), _text(value)) for name, value in shown]


def _text(value: Any) -> str:
    if math.isfinite(_float(value)):
        return f"{_float(value):.4g}"
    parsed = _parsed(value)
    if isinstance(parsed, dict):
        return ", ".join(f"{name} {_text(part)}" for name, part in parsed.items())
    return str(value)


def _parsed(value: Any) -> Any:
    try:
        return json.loads(value) if isinstance(value, str) else value
    except ValueError:
        return value


def _plan(attributes: Mapping[Any, Any]) -> str:
    parsed = _parsed(attributes.get("plan", ""))
    return parsed if isinstance(parsed, str) else json.dumps(parsed, indent=1)


def _float(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        return math.nan


def _slug(text: str) -> str:
    """A text as a part of file names and anchors."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")
