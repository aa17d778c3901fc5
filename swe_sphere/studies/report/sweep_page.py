"""A sweep as a page: one HTML file that needs nothing else, or Markdown with figures beside it."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping, Sequence
from io import BytesIO
from math import isfinite
from numbers import Real
from pathlib import Path
from typing import Any

from markupsafe import Markup, escape
from xarray import Dataset

from swe_sphere.durable import clear_errors, write_whole
from swe_sphere.studies.pages import rendered
from swe_sphere.studies.report import words
from swe_sphere.studies.report.axes import inline, save_svg
from swe_sphere.studies.report.content import (
    HEADS,
    Claim,
    OneMesh,
    Section,
    attribute,
    read_sections,
    verdicts,
)
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
    text = _rendered(
        "report.html.j2", title=title or _title(datasets), sections=sections, notes=notes or {},
        picture=_Pictures(out, png=True).inline,
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
        picture=_Pictures(folder, png=False).file,
    )  # fmt: skip
    write_whole(folder / "README.md", text)
    return folder / "README.md"


def _made(folder: str | os.PathLike[str], what: str) -> Path:
    """The folder, made where there is none."""
    with clear_errors(f"cannot write the {what} to {folder}"):
        Path(folder).mkdir(parents=True, exist_ok=True)
    return Path(folder)


def _title(datasets: Dataset | Mapping[str, Dataset]) -> str:
    first = datasets if isinstance(datasets, Dataset) else next(iter(datasets.values()), None)
    return str("" if first is None else first.attrs.get("title", "")) or TITLE


class _Pictures:
    """Draws diagrams into files of a folder, and hands them on."""

    def __init__(self, folder: Path, *, png: bool) -> None:
        self._folder = folder
        self._png = png

    def file(self, section: Section, mesh: OneMesh, diagram: Diagram) -> str:
        """Draw a diagram; returns the name of its SVG file."""
        return self._draw(section, mesh, diagram)[0]

    def inline(self, section: Section, mesh: OneMesh, diagram: Diagram) -> Markup:
        """Draw a diagram; returns it as an element of the page, its points with explanations."""
        name, svg = self._draw(section, mesh, diagram)
        tips = {f"{section.name}-{row.number}": _tip(row) for row in mesh.rows}
        return Markup(inline(svg, name.removesuffix(".svg"), diagram.title, tips))

    def _draw(self, section: Section, mesh: OneMesh, diagram: Diagram) -> tuple[str, str]:
        stem = f"{section.name}-{mesh.name}-{diagram.name}"
        figure = render(diagram, section.name)
        svg = save_svg(figure, stem)
        write_whole(self._folder / f"{stem}.svg", svg)
        if self._png:
            png = BytesIO()
            figure.savefig(png, format="png", dpi=DOTS_PER_INCH)
            write_whole(self._folder / f"{stem}.png", png.getvalue())
        return f"{stem}.svg", svg


def _tip(row: Row) -> str:
    return (
        f"row {row.number}: {row.stepper}, Δt {words.step(row.dt)} "
        f"({words.times(row.gravity_multiple)} gravity limit), "
        f"{row.cost_kind} {words.seconds(row.cost)}, {how_it_ended(row)}"
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
