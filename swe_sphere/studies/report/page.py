"""A sweep as a page: one HTML file that needs nothing else, and of recipes a Markdown file too."""

from __future__ import annotations

import json
import math
import os
import re
import tomllib
from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.resources import files
from numbers import Real
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from markupsafe import Markup, escape
from xarray import Dataset

from swe_sphere.files.durable import clear_errors, write_whole
from swe_sphere.studies import words
from swe_sphere.studies.pages import rendered
from swe_sphere.studies.report.figures import (
    Diagram,
    error_diagrams,
    other_diagrams,
    render,
    svg_text,
)
from swe_sphere.studies.report.ranking import (
    BASELINE,
    FAILED,
    SLACK,
    Ranking,
    Threshold,
    largest_step,
    rankings,
    threshold,
)
from swe_sphere.studies.report.table import (
    MADE_FOR_OTHERS,
    REPEATABLE,
    Metric,
    metrics,
    read_runs,
)
from swe_sphere.studies.sweep.sweep_plan import Claim, Recipe, SweepPlan

TITLE = "What accuracy costs in time"


# --- the contents of a page


@dataclass(frozen=True, eq=False)
class OneMesh:
    """One mesh of a scene."""

    name: str
    """Part of the names of files and anchors."""
    title: str
    runs: pd.DataFrame
    rankings: list[Ranking]
    """The one to rank by first."""
    errors: dict[Metric, list[Diagram]]
    """Figures of each error, the first ranking's first."""
    diagrams: list[Diagram]
    limits: dict[Metric, Threshold]
    """Errors that count as no loss of accuracy."""

    @property
    def largest_steps(self) -> tuple[list[str], list[list[str]]]:
        """Heads and lines of a table: stable steps, and steps without loss of accuracy."""
        heads = ["stepper", "largest completed step", "first failure"]
        heads += [f"{m.symbol}, {m.kind_title}" for m in self.limits]
        lines = []
        for label, curve in self.runs[self.runs["role"] != MADE_FOR_OTHERS].groupby("curve"):
            done, failed = curve[curve["completed"]], curve[curve["status"].isin(FAILED)]
            failure = "none"
            if len(failed):
                run = failed.loc[failed["dt"].idxmin()]
                failure = f"{words.step(run['dt'])}, {run.status} (row {run.number})"
            longest = done.loc[done["dt"].idxmax()] if len(done) else None
            lossless = [largest_step(curve, m, limit.value) for m, limit in self.limits.items()]
            lines.append([label, step_text(longest), failure, *map(step_text, lossless)])
        return heads, lines


@dataclass(frozen=True, eq=False)
class Section:
    """The sweep of one scene."""

    title: str
    dataset: Dataset
    runs: pd.DataFrame
    meshes: list[OneMesh]

    @property
    def name(self) -> str:
        """Part of the names of files and anchors."""
        return _slug(self.title)

    @property
    def headline(self) -> str:
        """One sentence for the top of a page."""
        told = [mesh.rankings[0].headline for mesh in self.meshes if mesh.rankings]
        none = f"No run of {self.dataset.attrs['scene']} has an error that could be compared."
        return told[0] if told else none


def records(runs: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the lines of a table of runs, for templates."""
    found: list[dict[str, Any]] = runs.to_dict("records")
    return found


def sweep_rankings(
    dataset: Dataset, metric: Metric | None = None, levels: Sequence[float] = ()
) -> list[Ranking]:
    """Return the ranking to go by for each mesh of a sweep: its headline and its table.

    metric: the error to rank by; None: the one that tells most.  levels: target errors, none: round
    ones.  Raises ConfigError if the dataset is not one of a sweep.
    """
    return [
        ranking
        for where, runs in _meshes(read_runs(dataset)).items()
        for ranking in rankings(
            runs, [metric] if metric else metrics(runs), where, _own_error(dataset), levels
        )[:1]
    ]


def search_rankings(dataset: Dataset, plan: SweepPlan) -> list[Ranking]:
    """Return rankings by the error that a plan has searched for, one for each mesh."""
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
    """Return one section for each dataset; ConfigError if one is not the dataset of a sweep."""
    if isinstance(datasets, Dataset):
        datasets = {str(datasets.attrs["scene"]): datasets}
    sections = []
    for title, dataset in datasets.items():
        runs, own = read_runs(dataset), _own_error(dataset)
        meshes = [_mesh(where, of, own) for where, of in _meshes(runs).items()]
        sections.append(Section(title, dataset, runs, meshes))
    return sections


def _own_error(dataset: Dataset) -> float:
    return float(dataset.attrs.get("converged_check", math.nan))


def _meshes(runs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return the runs of a scene by what they are called: the scene and the mesh."""
    shown = runs[runs["mesh"].isin(runs.loc[runs["role"] != MADE_FOR_OTHERS, "mesh"])]
    return {", ".join(of): found for of, found in shown.groupby(["scene", "mesh"], sort=False)}


def _mesh(where: str, runs: pd.DataFrame, own: float) -> OneMesh:
    """Describe a mesh; losses are of total and slow-flow errors, where there are any.

    Any stepper's shortest step is without time error.
    """
    found = metrics(runs)
    ranked = rankings(runs, found, where, own)
    first = [ranking.metric for ranking in ranked[:1]]
    errors = {m: error_diagrams(runs, m) for m in dict.fromkeys([*first, *found])}
    chosen = [m for m in found if m.kind in ("total", "slow")] or found
    return OneMesh(
        _slug(runs["mesh"].iloc[0]), where, runs, ranked,
        errors={metric: drawn for metric, drawn in errors.items() if drawn},
        diagrams=other_diagrams(runs),
        limits={m: limit for m in chosen if (limit := threshold(runs, m)) is not None},
    )  # fmt: skip


def _slug(text: str) -> str:
    """Return a text as a part of file names and anchors."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


# --- tables


class Column(NamedTuple):
    """A column of the table of all runs."""

    title: str
    name: str | Metric
    """Of the column in a table of runs."""
    text: str = ""
    """How numbers are written: a function of `words`; empty where there are words."""
    essential: bool = False
    """Whether short tables have it."""

    def cell(self, run: Mapping[Any, Any]) -> str:
        """Return what is shown of a run."""
        return str(getattr(words, self.text)(run[self.name]) if self.text else run[self.name])


def columns(runs: pd.DataFrame) -> list[Column]:
    """Return the columns that say something about these runs."""
    text = files(__package__).joinpath("templates/columns.toml").read_text(encoding="utf-8")
    known = {part: [Column(**of) for of in table] for part, table in tomllib.loads(text).items()}
    errors = [
        Column(f"{m.symbol} {m.kind}, day {m.day:g}", m, "error", True) for m in metrics(runs)
    ]
    lines = records(runs)
    return [
        column
        for column in (*known["settings"], *errors, *known["costs"])
        if column.essential or any(column.cell(run) not in ("", words.NOTHING) for run in lines)
    ]


def step_text(run: pd.Series | None, numbered: bool = True) -> str:
    """Return a run's step with the multiples of its limits; numbered: and the run's number."""
    if run is None:
        return "none"
    multiples = f"{words.times(run.gravity_multiple)}, {words.times(run.advective_multiple)}"
    return f"{words.step(run['dt'])} ({multiples}{f'; row {run.number}' if numbered else ''})"


def csv_text(sections: Sequence[Section]) -> str:
    """Return all that is known of the runs of sections, in SI units; every error in a column.

    Fields that are not finite are empty.
    """
    tables = {
        of.title: of.runs.drop(columns="number").dropna(axis=1, how="all")
        .rename(columns={m: m.name for m in of.runs if isinstance(m, Metric)})
        for of in sections
    }  # fmt: skip
    table = pd.concat(tables, names=["dataset", "number"])
    text: str = table.replace([math.inf, -math.inf], math.nan).to_csv()
    return text


def _verdicts(mesh: OneMesh, claim: Claim) -> Iterator[list[str]]:
    """Yield lines of a table: the longest steps without loss, and whether that is as claimed.

    Of steppers that took steps of as many gravity-wave limits as are claimed.
    """
    total = {metric.field: metric for metric in mesh.errors if metric.kind == "total"}
    shown = [total[field] for field in ("h", "vorticity") if field in total]
    claimed = f"{words.times(claim.gravity)}, {words.times(claim.advective)}"
    for label, curve in mesh.runs[mesh.runs["compared"]].groupby("curve"):
        longest = curve.loc[curve["dt"].idxmax()]
        if longest.gravity_multiple < claim.gravity:
            continue
        limits = {m: mesh.limits[m].value if m in mesh.limits else -math.inf for m in shown}
        steps = [largest_step(curve, metric, limit) for metric, limit in limits.items()]
        met = [
            "yes" if run is not None and run.gravity_multiple >= claim.gravity
            and run.advective_multiple >= claim.advective else "no"
            for run in steps
        ]  # fmt: skip
        each = [f"{answer} ({m.symbol})" for answer, m in zip(met, shown, strict=True)]
        verdict = met[0] if len({*met}) == 1 else ", ".join(each)
        cells = [step_text(run, numbered=False) for run in (*steps, longest)]
        yield [mesh.title, label, claimed, *cells[:-1], verdict, cells[-1]]


# --- files


def write_report(
    datasets: Dataset | Mapping[str, Dataset],
    out: str | os.PathLike[str],
    *,
    title: str = "",
    recipe: Recipe | None = None,
) -> Path:
    """Write index.html, its figures (SVG) and table.csv into a folder.

    datasets: what `sweep` returns, or several by name: a section each.
    title: of the page; empty: the recipe's, or the first dataset's.
    recipe: of the sweeps; its introduction, notes and claims are shown, and README.md written too.
    Returns the path of index.html.  Raises ConfigError if a dataset is not one of a sweep or the
    folder cannot be made, RunFailed if the disk refuses; each file is the old one or the new one.
    """
    with clear_errors(f"cannot write the report to {out}"):
        Path(out).mkdir(parents=True, exist_ok=True)
    out, sections = Path(out), read_sections(datasets)
    told = recipe.title if recipe else sections[0].dataset.attrs.get("title", "")
    pictures = {
        diagram: picture
        for section in sections
        for mesh in section.meshes
        for diagram, picture in _pictures(mesh, section.name).items()
    }
    for name, svg in pictures.values():
        write_whole(out / name, svg)
    values = {
        "title": title or told or TITLE, "sections": sections, "recipe": recipe,
        "notes": recipe.notes if recipe else {},
    }  # fmt: skip
    inline = {
        diagram: f"data:image/svg+xml;base64,{b64encode(svg.encode()).decode()}"
        for diagram, (_, svg) in pictures.items()
    }
    write_whole(out / "table.csv", csv_text(sections))
    write_whole(out / "index.html", _rendered("report.html.j2", **values, pictures=inline))
    if recipe is not None:
        verdicts = [
            line
            for section in sections
            for mesh in (section.meshes if section.title in recipe.claims else ())
            for line in _verdicts(mesh, recipe.claims[section.title])
        ]
        names = {diagram: name for diagram, (name, _) in pictures.items()}
        page = _rendered("page.md.j2", **values, pictures=names, verdicts=verdicts)
        write_whole(out / "README.md", page)
    return out / "index.html"


def _pictures(mesh: OneMesh, section: str) -> dict[Diagram, tuple[str, str]]:
    """Return the name and the text of the file of each diagram."""
    drawn = [*(diagram for of in mesh.errors.values() for diagram in of), *mesh.diagrams]
    stems = {diagram: f"{section}-{mesh.name}-{diagram.name}" for diagram in drawn}
    return {of: (f"{stem}.svg", svg_text(render(of), stem)) for of, stem in stems.items()}


def _rendered(template: str, **values: Any) -> str:
    return rendered(
        "swe_sphere.studies.report", template, _link_rows, _attribute, records, json.loads,
        **values, columns=columns, repeatable=REPEATABLE, slack=SLACK, baseline=BASELINE,
    )  # fmt: skip


def _attribute(value: Any) -> str:
    """Return an attribute of a dataset as it is shown."""
    with suppress(ValueError):
        value = json.loads(value) if isinstance(value, str) else value
    if isinstance(value, dict):
        return ", ".join(f"{name} {_attribute(part)}" for name, part in value.items())
    return f"{value:.4g}" if isinstance(value, Real) else str(value)


def _link_rows(text: str, section: str) -> Markup:
    """Return escaped text in which "row 12" leads to that row of the section's table."""
    link = rf'<a href="#{section}-\1">row&nbsp;\1</a>'
    linked = re.sub(r"\brow (\d+)\b", link, str(escape(text)))
    return Markup(re.sub(r"(\d) (s|%)(?!\w)", r"\1&nbsp;\2", linked))
