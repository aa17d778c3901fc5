"""All that a page says on one scene, ready for a template."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from swe_sphere.studies.report import words
from swe_sphere.studies.report.answer import (
    Answer,
    answers,
    noise_sentence,
    saturation_sentence,
    settings,
)
from swe_sphere.studies.report.figures import Diagram, diagrams, error_diagrams
from swe_sphere.studies.report.losses import LossTable, loss_table
from swe_sphere.studies.report.rows import MADE_FOR_OTHERS, Metric, Row, metrics, read_rows
from swe_sphere.studies.report.table import how_it_ended

if TYPE_CHECKING:
    from xarray import Dataset

__all__ = ["Choice", "Failure", "Part", "Section", "read_sections", "slug"]

ANSWERED = {"total": ("h", "v", "vorticity"), "time": ("h", "v", "vorticity"),
            "slow": ("vorticity", "h", "v")}  # fmt: skip
"""For each kind of error the field that the answer speaks of: the first one there is."""
MADE = {
    "command": "command", "created": "made", "machine": "machine", "cores": "cores",
    "versions": "versions", "noise": "noise of the machine",
    "converged_dt": "step of the converged run [s]",
    "converged_check": "own time error of the converged run",
}  # fmt: skip
HIDDEN = ("title", "scene", "plan")


@dataclass(frozen=True)
class Choice:
    """One of the errors a reader can choose, on one mesh."""

    metric: Metric
    answers: list[Answer]
    """Sentences, none where it speaks of another field."""
    saturation: str
    diagrams: list[Diagram]


@dataclass(frozen=True)
class Failure:
    """A run that did not reach its end."""

    number: int
    setting: str
    step: str
    text: str


@dataclass(frozen=True)
class Part:
    """One mesh of a scene."""

    name: str
    """For file names and anchors."""
    title: str
    rows: list[Row]
    choices: list[Choice]
    diagrams: list[Diagram]
    losses: LossTable
    failures: list[Failure]


@dataclass(frozen=True)
class Section:
    """One scene."""

    name: str
    """For file names and anchors."""
    title: str
    scene: str
    rows: list[Row]
    metrics: list[Metric]
    parts: list[Part]
    trust: list[str]
    """How far times and errors can be trusted."""
    made: list[tuple[str, str]]
    plan: str

    @property
    def headline(self) -> str:
        """One sentence for the top of a page."""
        told = [sentence for part in self.parts for sentence in _headline(part)]
        return told[0] if told else f"No run of {self.scene} has an error that could be compared."


def read_sections(
    datasets: Dataset | Mapping[str, Dataset], levels: Sequence[float] = ()
) -> list[Section]:
    """One section for each scene of each dataset.

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
    noise, own = (_float(attributes.get(key)) for key in ("noise", "converged_check"))
    terms = _Terms(noise, own, levels)
    meshes = list(dict.fromkeys(row.mesh for row in rows if row.role not in MADE_FOR_OTHERS))
    found = metrics(rows)
    return Section(
        name=slug(name) or "sweep",
        title=name or scene or "sweep",
        scene=scene,
        rows=rows,
        metrics=found,
        parts=[
            _part(scene, mesh, [row for row in rows if row.mesh == mesh], found, terms)
            for mesh in meshes
        ],
        trust=[text for text in (noise_sentence(rows, noise), _converged(attributes)) if text],
        made=_made(attributes),
        plan=_plan(attributes),
    )


@dataclass(frozen=True)
class _Terms:
    """How well times and time errors are known, and the error levels asked for."""

    noise: float
    own: float
    levels: Sequence[float]

    def answers(self, rows: Sequence[Row], metric: Metric, where: str) -> list[Answer]:
        # the check of the converged run is on its depth
        resolved = self.own if (metric.kind, metric.field) == ("time", "h") else 0.0
        return answers(rows, metric, where, self.noise, self.levels, resolved)


def _part(scene: str, mesh: str, rows: list[Row], found: list[Metric], terms: _Terms) -> Part:
    where = f"{scene} at {mesh}" if mesh else scene
    told = _told(rows, found, where)
    choices = [
        Choice(
            metric,
            terms.answers(rows, metric, where) if metric in spoken(found) else [],
            told.get(metric, ""),
            error_diagrams(rows, metric, terms.noise),
        )
        for metric in found
    ]
    return Part(
        name=slug(mesh) or "mesh",
        title=mesh or "mesh",
        rows=rows,
        choices=[choice for choice in choices if choice.diagrams],
        diagrams=diagrams(rows),
        losses=loss_table(rows, found),
        failures=_failures(rows),
    )


def spoken(found: Sequence[Metric]) -> list[Metric]:
    """The errors that the answer speaks of: one of each kind."""
    by_name = {(metric.kind, metric.field): metric for metric in found}
    first = (
        next((by_name[kind, field] for field in order if (kind, field) in by_name), None)
        for kind, order in ANSWERED.items()
    )
    return [metric for metric in first if metric is not None]


def _told(rows: Sequence[Row], found: Sequence[Metric], where: str) -> dict[Metric, str]:
    """What is said on saturation: on the first error of the depth that does."""
    slow = any(metric.kind == "slow" for metric in found)
    for metric in found:
        fast = metric.field == "h" and metric.kind != "slow"
        if fast and (sentence := saturation_sentence(rows, metric, where, slow)):
            return {metric: sentence}
    return {}


def _headline(part: Part) -> list[str]:
    """The sentence on the smallest level that two steppers reach, or else one.

    Of the first error that is told; of the slow flow where the depth says nothing on steppers.
    """
    saturates = any("saturates" in choice.saturation for choice in part.choices)
    for choice in sorted(part.choices, key=lambda c: c.metric.kind != "slow" and saturates):
        for steppers in (2, 1):
            if told := [answer.text for answer in choice.answers if answer.steppers >= steppers]:
                return told[-1:]
    return []


def _failures(rows: Iterable[Row]) -> list[Failure]:
    rows = list(rows)
    names = settings(rows)
    return [
        Failure(row.number, names[row.number], words.step(row.dt), how_it_ended(row))
        for row in rows
        if not row.completed
    ]


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
    """What is known of how a dataset was made: first what every sweep writes, then the rest."""
    known = [(label, attributes[name]) for name, label in MADE.items() if name in attributes]
    others = [
        (str(name).replace("_", " "), value)
        for name, value in attributes.items()
        if name not in MADE and name not in HIDDEN
    ]
    return [(label, _text(label, value)) for label, value in (*known, *others)]


def _text(label: str, value: Any) -> str:
    if label == MADE["noise"] and math.isfinite(_float(value)):
        return f"wall times of a calibration run spread over {words.percent(_float(value))}"
    if math.isfinite(_float(value)):
        return f"{_float(value):.4g}"
    parsed = _parsed(value)
    if isinstance(parsed, dict):
        return ", ".join(f"{name} {_text('', part)}" for name, part in parsed.items())
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


def slug(text: str) -> str:
    """A text as a part of file names and anchors."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")
