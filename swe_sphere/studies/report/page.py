"""A sweep as a page: one HTML file that needs nothing else, or Markdown with figures beside it."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from numbers import Real
from pathlib import Path
from typing import Any

import pandas as pd
from markupsafe import Markup, escape
from matplotlib.figure import Figure
from xarray import Dataset

from swe_sphere.files.durable import clear_errors, write_whole
from swe_sphere.studies import words
from swe_sphere.studies.pages import rendered
from swe_sphere.studies.report.figures import (
    Diagram,
    diagrams,
    error_diagrams,
    inline,
    render,
    save_svg,
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
from swe_sphere.studies.report.rows import (
    MADE_FOR_OTHERS,
    REPEATABLE,
    Metric,
    Row,
    curves,
    metrics,
    read_rows,
)
from swe_sphere.studies.sweep.sweep_plan import SweepPlan

DOTS_PER_INCH = 160
TITLE = "What accuracy costs in time"
SHOWN = ("time", "step")
OTHERS = ("krylov_iterations", "energy_drift", "stability")


# --- the contents of a page


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
    """Figures of each error, the first ranking's first."""
    diagrams: list[Diagram]
    limits: dict[Metric, Threshold]
    """Errors that count as no loss of accuracy."""
    names: dict[int, str]
    """The stepper of each row as figures have it, by its number."""

    @property
    def failures(self) -> list[Row]:
        """Runs that did not reach their end."""
        return [row for row in self.rows if not row.completed]

    @property
    def largest_steps(self) -> tuple[list[str], list[list[str]]]:
        """Heads and lines of a table: stable steps, and steps without loss of accuracy."""
        heads = ["stepper", "largest completed step", "first failure"]
        heads += [f"{m.symbol}, {m.kind_title}" for m in self.limits]
        lines = [
            [curve.label, _longest(curve.rows), _failure(curve.rows)]
            + [step_text(largest_step(curve.rows, *limit)) for limit in self._losses]
            for curve in curves(row for row in self.rows if row.role not in MADE_FOR_OTHERS)
        ]
        return heads, lines

    @property
    def _losses(self) -> list[tuple[Metric, float]]:
        return [(metric, limit.value) for metric, limit in self.limits.items()]


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
    own = float(dataset.attrs.get("converged_check", math.nan))
    return [
        ranking
        for where, rows in _meshes(read_rows(dataset)).items()
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


def _meshes(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """The rows of a scene by what they are called: the scene and the mesh."""
    told = {row.mesh for row in rows if row.role not in MADE_FOR_OTHERS}
    found: dict[str, list[Row]] = {}
    for row in rows:
        if row.mesh in told:
            found.setdefault(f"{row.scene}, {row.mesh}", []).append(row)
    return found


def _section(name: str, dataset: Dataset) -> Section:
    rows, own = read_rows(dataset), float(dataset.attrs.get("converged_check", math.nan))
    meshes = [_mesh(where, members, own) for where, members in _meshes(rows).items()]
    scene = dataset.attrs["scene"]
    return Section(_slug(name), name, scene, rows, metrics(rows), meshes, dataset.attrs)


def _mesh(where: str, rows: list[Row], own: float) -> OneMesh:
    """Losses are told of total and slow-flow errors; of time errors where there are no others,
    as any stepper's shortest step is without time error.
    """
    found = metrics(rows)
    ranked = rankings(rows, found, where, own)
    first = [ranking.metric for ranking in ranked[:1]]
    errors = [(m, error_diagrams(rows, m)) for m in dict.fromkeys([*first, *found])]
    chosen = [m for m in found if m.kind in ("total", "slow")] or found
    return OneMesh(
        _slug(rows[0].mesh), where, rows, ranked,
        errors=[(metric, drawn) for metric, drawn in errors if drawn],
        diagrams=diagrams(rows),
        limits={m: limit for m in chosen if (limit := threshold(rows, m)) is not None},
        names={row.number: curve.label for curve in curves(rows) for row in curve.rows},
    )  # fmt: skip


def _slug(text: str) -> str:
    """A text as a part of file names and anchors."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


# --- tables


@dataclass(frozen=True)
class Column:
    """A column of the table of all runs."""

    title: str
    value: Callable[[Row], Any]
    text: Callable[[float], str] | None = None
    """How numbers are written; None where there are words."""
    essential: bool = False
    """Whether short tables have it."""

    def cell(self, row: Row) -> str:
        """What is shown of a row."""
        return str(self.value(row) if self.text is None else self.text(self.value(row)))

    def sort_key(self, row: Row) -> str:
        """What to sort by; empty: last."""
        value = self.value(row)
        return str(value) if self.text is None else repr(value) if math.isfinite(value) else ""


def columns(rows: Sequence[Row], metrics: Sequence[Metric]) -> list[Column]:
    """The columns that say something about these rows."""
    errors = [
        Column(f"{m.symbol} {m.kind}, day {m.day:g}", lambda r, m=m: r.error(m), words.error, True)  # type: ignore[misc]
        for m in metrics
    ]
    return [
        column
        for column in (*_SETTINGS, *errors, *_COSTS)
        if column.essential or any(column.cell(row) not in ("", words.NOTHING) for row in rows)
    ]


def how_it_ended(row: Row) -> str:
    """In words: the reason where there is one, else the status."""
    if row.completed or not row.reason:
        return str(row.status)
    return f"{row.status}: {row.reason}"


def _signed(value: float) -> str:
    return f"+{words.error(value)}" if value > 0.0 else words.error(value)


_SETTINGS = (
    Column("row", lambda r: float(r.number), words.count, essential=True),
    Column("stepper", lambda r: r.stepper, essential=True),
    Column("preconditioner", lambda r: r.preconditioner),
    Column("mesh", lambda r: r.mesh),
    Column("Δt", lambda r: r.dt, words.step, essential=True),
    Column("Δt / gravity limit", lambda r: r.gravity_multiple, words.times, essential=True),
    Column("Δt / advective limit", lambda r: r.advective_multiple, words.times, essential=True),
    Column("how it ended", how_it_ended, essential=True),
)
_COSTS = (
    Column("CPU", lambda r: r.cpu_seconds, words.seconds, essential=True),
    Column("spread", lambda r: r.spread, words.percent, essential=True),
    Column("wall", lambda r: r.wall_seconds, words.seconds),
    Column("right-hand sides", lambda r: r.rhs_evaluations, words.count, essential=True),
    Column("Jacobian products", lambda r: r.tangent_evaluations, words.count, essential=True),
    Column("preconditionings", lambda r: r.preconditioner_applications, words.count, True),
    Column("Newton a step", lambda r: r.per_step("newton_iterations"), words.number),
    Column("Krylov a step", lambda r: r.per_step("krylov_iterations"), words.number, True),
    Column("rejected steps", lambda r: r.rejected_steps, words.count),
    Column("mass drift", lambda r: r.mass_drift, _signed),
    Column("energy drift", lambda r: r.energy_drift, _signed, essential=True),
    Column("enstrophy drift", lambda r: r.enstrophy_drift, _signed),
    Column("compilation", lambda r: r.compile_seconds, words.seconds),
    Column("memory", lambda r: r.peak_memory, words.bytes_text),
    Column("precision", lambda r: r.precision),
    Column("device", lambda r: r.device),
    Column("settings", lambda r: r.settings),
    Column("days", lambda r: r.days, words.number),
    Column("steps", lambda r: r.steps, words.count),
    Column("role", lambda r: r.role),
)


def step_text(row: Row | None, numbered: bool = True) -> str:
    """The step of a row with the multiples of its limits; numbered: and with the row's number."""
    if row is None:
        return "none"
    multiples = f"{words.times(row.gravity_multiple)}, {words.times(row.advective_multiple)}"
    return f"{words.step(row.dt)} ({multiples}{f'; row {row.number}' if numbered else ''})"


def _longest(rows: Sequence[Row]) -> str:
    return step_text(max((r for r in rows if r.completed), key=lambda r: r.dt, default=None))


def _failure(rows: Sequence[Row]) -> str:
    """The shortest step at which the scheme itself failed."""
    failed = [row for row in rows if row.status in FAILED]
    row = min(failed, key=lambda r: r.dt, default=None)
    return f"{words.step(row.dt)}, {row.status} (row {row.number})" if row else "none"


def csv_text(sections: Sequence[Section]) -> str:
    """All that is known of the rows of sections, in SI units; every error in a column.

    Fields that are not finite are empty.
    """
    found = {metric for of in sections for row in of.rows for metric in row.errors}
    errors = sorted(found, key=lambda metric: metric.name)
    lines = [
        {"dataset": of.title, "number": row.number, **row.values}
        | {metric.name: row.error(metric) for metric in errors}
        for of in sections
        for row in of.rows
    ]
    table = pd.DataFrame(lines or None, columns=None if lines else ["dataset", "number"])
    text: str = table.replace([math.inf, -math.inf], math.nan).to_csv(index=False)
    return text


# --- claims of others


@dataclass(frozen=True)
class Claim:
    """That steps of so many gravity-wave and advective limits lose no accuracy."""

    gravity: float
    advective: float
    why: str = ""
    """Markdown: what the runs say to it."""

    def met(self, row: Row | None) -> bool:
        """Whether a longest step without loss is as long as claimed."""
        return row is not None and (
            row.gravity_multiple >= self.gravity and row.advective_multiple >= self.advective
        )


VERDICT_FIELDS = ("h", "vorticity")
VERDICT_HEADS = (
    "scene", "stepper", "claimed", "l2(h)", "l2(vorticity)", "confirmed", "longest step tried",
)  # fmt: skip


def _verdicts(mesh: OneMesh, claim: Claim) -> Iterator[list[str]]:
    """Lines under the heads: the longest steps without loss, and whether that is as claimed.

    Of steppers that took steps of as many gravity-wave limits as are claimed.
    """
    total = [metric for metric, _ in mesh.errors if metric.kind == "total"]
    shown = [metric for field in VERDICT_FIELDS for metric in total if metric.field == field]
    claimed = f"{words.times(claim.gravity)}, {words.times(claim.advective)}"
    for curve in curves([row for row in mesh.rows if row.compared]):
        longest = max(curve.rows, key=lambda row: row.dt)
        if longest.gravity_multiple < claim.gravity:
            continue
        limits = [mesh.limits.get(metric) for metric in shown]
        steps = [
            largest_step(curve.rows, metric, limit.value) if limit else None
            for metric, limit in zip(shown, limits, strict=True)
        ]
        met = ["yes" if claim.met(row) else "no" for row in steps]
        each = [f"{answer} ({m.symbol})" for answer, m in zip(met, shown, strict=True)]
        verdict = met[0] if len({*met}) == 1 else ", ".join(each)
        cells = [step_text(row, numbered=False) for row in (*steps, longest)]
        yield [mesh.title, curve.label, claimed, *cells[:-1], verdict, cells[-1]]


# --- files


def write_report(
    datasets: Dataset | Mapping[str, Dataset],
    out: str | os.PathLike[str],
    *,
    title: str = "",
    notes: Mapping[str, str] | None = None,
) -> Path:
    """Write index.html, its figures as SVG and PNG, and table.csv into a folder.

    datasets: what `sweep` returns, or several by name: a section each.
    title: of the page; empty: the first dataset's.
    notes: text for the section of that name.
    Returns the path of index.html.  Raises ConfigError if a dataset is not one of a sweep or the
    folder cannot be made, RunFailed if the disk refuses; each file is the old one or the new one.
    """
    out = _made(out, "report")
    sections = read_sections(datasets)
    told = sections[0].attributes.get("title") if sections else ""
    text = _rendered(
        "report.html.j2", title=title or told or TITLE, sections=sections, notes=notes or {},
        picture=partial(_inline, out),
    )  # fmt: skip
    write_whole(out / "table.csv", csv_text(sections))
    write_whole(out / "index.html", text)
    return out / "index.html"


def write_markdown(
    datasets: Dataset | Mapping[str, Dataset],
    folder: str | os.PathLike[str],
    *,
    title: str = TITLE,
    introduction: str = "",
    notes: Mapping[str, str] | None = None,
    claims: Mapping[str, Claim] | None = None,
    figures: Sequence[str] = OTHERS,
) -> Path:
    """Write README.md and its figures (SVG) into a folder.

    introduction: Markdown after the title.  notes: Markdown for the section of that name.  claims:
    what a section's runs are held against, in a table at the top.
    figures: diagrams beside those of the errors, by name.  The rest is as for `write_report`.
    """
    folder = _made(folder, "page")
    sections, claims = read_sections(datasets), claims or {}
    verdicts = [
        line
        for section in sections
        for mesh in (section.meshes if section.title in claims else ())
        for line in _verdicts(mesh, claims[section.title])
    ]
    text = _rendered(
        "page.md.j2", title=title, introduction=introduction, notes=notes or {}, sections=sections,
        shown=SHOWN, figures=figures, claims=claims, verdicts=[VERDICT_HEADS, verdicts],
        picture=partial(_file, folder),
    )  # fmt: skip
    write_whole(folder / "README.md", text)
    return folder / "README.md"


def _made(folder: str | os.PathLike[str], what: str) -> Path:
    """The folder, made where there is none."""
    with clear_errors(f"cannot write the {what} to {folder}"):
        Path(folder).mkdir(parents=True, exist_ok=True)
    return Path(folder)


def _file(folder: Path, section: Section, mesh: OneMesh, diagram: Diagram) -> str:
    """Draw a diagram; returns the name of its SVG file."""
    return f"{_drawn(folder, section, mesh, diagram)[0]}.svg"


def _inline(folder: Path, section: Section, mesh: OneMesh, diagram: Diagram) -> Markup:
    """Draw a diagram; returns it as an element of the page, its points with explanations."""
    stem, svg, figure = _drawn(folder, section, mesh, diagram)
    png = BytesIO()
    figure.savefig(png, format="png", dpi=DOTS_PER_INCH)
    write_whole(folder / f"{stem}.png", png.getvalue())
    tips = {f"{section.name}-{row.number}": _tip(row) for row in mesh.rows}
    return Markup(inline(svg, stem, diagram.title, tips))


def _drawn(
    folder: Path, section: Section, mesh: OneMesh, diagram: Diagram
) -> tuple[str, str, Figure]:
    """Name, text and figure of a diagram, whose SVG file is written."""
    stem = f"{section.name}-{mesh.name}-{diagram.name}"
    figure = render(diagram, section.name)
    svg = save_svg(figure, stem)
    write_whole(folder / f"{stem}.svg", svg)
    return stem, svg, figure


def _tip(row: Row) -> str:
    return (
        f"row {row.number}: {row.stepper}, Δt {words.step(row.dt)} "
        f"({words.times(row.gravity_multiple)} gravity limit), "
        f"{row.clock} {words.seconds(row.cost)}, {how_it_ended(row)}"
    )


def _rendered(template: str, **values: Any) -> str:
    """A template filled in."""
    return rendered(
        "swe_sphere.studies.report", template, _link_rows, _attribute, how_it_ended, json.loads,
        **values, columns=columns, repeatable=REPEATABLE, slack=SLACK, baseline=BASELINE,
    )  # fmt: skip


def _attribute(value: Any) -> str:
    """An attribute of a dataset as it is shown."""
    with suppress(ValueError):
        value = json.loads(value) if isinstance(value, str) else value
    if isinstance(value, dict):
        return ", ".join(f"{name} {_attribute(part)}" for name, part in value.items())
    return f"{value:.4g}" if isinstance(value, Real) else str(value)


def _link_rows(text: str, section: str) -> Markup:
    """Escaped text in which "row 12" leads to that row of the section's table."""
    link = rf'<a href="#{section}-\1">row&nbsp;\1</a>'
    linked = re.sub(r"\brow (\d+)\b", link, str(escape(text)))
    return Markup(re.sub(r"(\d) (s|%)(?!\w)", r"\1&nbsp;\2", linked))
