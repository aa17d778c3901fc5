"""A sweep as a page: one HTML file that needs nothing else, or Markdown with figures beside it."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping, Sequence
from functools import partial
from io import BytesIO
from math import isfinite
from numbers import Real
from pathlib import Path
from typing import Any

from markupsafe import Markup, escape
from matplotlib.figure import Figure
from xarray import Dataset

from swe_sphere.files.durable import clear_errors, write_whole
from swe_sphere.studies.pages import rendered
from swe_sphere.studies.report import words
from swe_sphere.studies.report.axes import inline, save_svg
from swe_sphere.studies.report.claims import HEADS, Claim, verdicts
from swe_sphere.studies.report.content import OneMesh, Section, attribute, read_sections
from swe_sphere.studies.report.diagrams import Diagram, render
from swe_sphere.studies.report.rows import REPEATABLE, Row
from swe_sphere.studies.report.statistics import BASELINE, SLACK
from swe_sphere.studies.report.table import columns, csv_text, how_it_ended

DOTS_PER_INCH = 160
TITLE = "What accuracy costs in time"
SHOWN = ("time", "step")
OTHERS = ("krylov_iterations", "energy_drift", "stability")


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
    rows = csv_text([(section.title, section.rows) for section in sections])
    write_whole(out / "table.csv", rows)
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
    text = _rendered(
        "page.md.j2", title=title, introduction=introduction, notes=notes or {}, sections=sections,
        shown=SHOWN, figures=figures, claims=claims, verdicts=[HEADS, verdicts(sections, claims)],
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
    filters = (_link_rows, attribute, json.loads, words.error, words.percent, words.step, _known)
    return rendered(
        "swe_sphere.studies.report", template, *filters, **values, columns=columns,
        repeatable=REPEATABLE, slack=SLACK, baseline=BASELINE,
    )  # fmt: skip


def _known(value: Any) -> bool:
    """Whether it is a number."""
    return isinstance(value, Real) and isfinite(value)


def _link_rows(text: str, section: str) -> Markup:
    """Escaped text in which "row 12" leads to that row of the section's table."""
    link = rf'<a href="#{section}-\1">row&nbsp;\1</a>'
    linked = re.sub(r"\brow (\d+)\b", link, str(escape(text)))
    return Markup(re.sub(r"(\d) (s|%)(?!\w)", r"\1&nbsp;\2", linked))
