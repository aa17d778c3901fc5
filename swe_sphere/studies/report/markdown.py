"""A sweep as a page of the documentation: Markdown with its figures beside it."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from swe_sphere.durable import write_whole
from swe_sphere.io.disk import clear_errors
from swe_sphere.studies.report.figures import Diagram
from swe_sphere.studies.report.page import Pictures, environment
from swe_sphere.studies.report.section import Part, read_sections
from swe_sphere.studies.report.table import cell, columns

if TYPE_CHECKING:
    from xarray import Dataset

__all__ = ["write_markdown"]

SHOWN = ("wall", "step")
OTHERS = ("krylov_iterations", "energy_drift", "stability")


def write_markdown(
    datasets: Dataset | Mapping[str, Dataset],
    folder: str | os.PathLike[str],
    *,
    title: str = "What accuracy costs in time",
    introduction: str = "",
    levels: Sequence[float] = (),
    notes: Mapping[str, str] | None = None,
    figures: Sequence[str] = OTHERS,
) -> Path:
    """Write README.md and its figures (SVG) into a folder.

    introduction: Markdown after the title.  notes: Markdown for the section of that name, after
    its answer.  figures: diagrams beside those of the errors, by name.  The rest is as for
    `write_report`.
    """
    folder = Path(folder)
    sections = read_sections(datasets, levels)
    with clear_errors(f"cannot write the page to {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
    text = environment(html=False).get_template("page.md.j2").render(
        title=title, introduction=introduction, sections=sections, notes=notes or {},
        shown=lambda part: _shown(part, figures), picture=Pictures(folder, png=False).file,
        columns=columns, cell=cell,
    )  # fmt: skip
    page = folder / "README.md"
    write_whole(page, text)
    return page


def _shown(part: Part, others: Sequence[str]) -> list[Diagram]:
    """Two diagrams for each error that the answer speaks of, then the others asked for."""
    errors = [
        diagram
        for choice in part.choices
        if choice.answers
        for diagram in choice.diagrams
        if diagram.name.endswith(SHOWN)
    ]
    return [*errors, *(diagram for diagram in part.diagrams if diagram.name in others)]
