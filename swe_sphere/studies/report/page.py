"""A sweep as a page: one self-contained HTML file, and for recipes a Markdown file too."""

import json
import os
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup, escape
from xarray import Dataset

from swe_sphere.files.fingerprints import fingerprint
from swe_sphere.settings.values import read_toml
from swe_sphere.studies import words
from swe_sphere.studies.pages import rendered, write_made
from swe_sphere.studies.report.figures import Picture, error_pictures, other_pictures
from swe_sphere.studies.report.ranking import Metric, Ranking, metrics, rankings, read_runs
from swe_sphere.studies.sweep.record import REPEATABLE
from swe_sphere.studies.sweep.sweep_plan import Recipe

TITLE = "What accuracy costs in time"
COLUMNS = Path(__file__).with_name("templates") / "columns.toml"


@dataclass(frozen=True, eq=False)
class Section:
    """The runs of a sweep on one mesh."""

    title: str
    """Title of the sweep."""
    mesh: str
    dataset: Dataset
    """The whole sweep."""
    runs: pd.DataFrame
    rankings: list[Ranking]
    """Rankings by kind of error; the first one provides the headline."""

    @cached_property
    def figures(self) -> list[list[Picture]]:
        """Figures of the error of each ranking."""
        return [[*error_pictures(self.runs, x.metric, self.name, x.floor)] for x in self.rankings]

    @cached_property
    def others(self) -> list[Picture]:
        """Figures of iterations and conservation."""
        return [*other_pictures(self.runs, self.name)]

    @property
    def anchor(self) -> str:
        """Part of the anchors of rows, which are numbered through the sweep."""
        text = slug(self.title)
        return text if text == self.title else slug(f"{text} {fingerprint([self.title])[:6]}")

    @property
    def name(self) -> str:
        """Part of the names of files, and the anchor of the section."""
        return slug(f"{self.anchor} {self.mesh}")

    @property
    def headline(self) -> str:
        """One sentence for the top of a page."""
        none = f"No run of {self.dataset.attrs['scene']} has an error that could be compared."
        return self.rankings[0].headline if self.rankings else none


def sweep_rankings(datasets: Dataset | Mapping[str, Dataset]) -> list[Ranking]:
    """Return the decisive ranking for each mesh of sweeps: its headline and its table.

    It ranks by the error of the search, or by the first available error of `ranking.ANSWERED`.
    Raises ConfigError if a dataset is not one of a sweep.
    """
    return [ranking for section in read_sections(datasets) for ranking in section.rankings[:1]]


def read_sections(datasets: Dataset | Mapping[str, Dataset]) -> list[Section]:
    """Return a section for each mesh of sweeps; ConfigError for a dataset of another kind."""
    if isinstance(datasets, Dataset):
        datasets = {str(datasets.attrs.get("scene", "")): datasets}
    sections = []
    for title, dataset in datasets.items():
        plan = json.loads(dataset.attrs.get("plan", "{}"))
        levels = np.atleast_1d(plan.get("target_error") or [])
        for where, runs in read_runs(dataset).groupby(["scene", "mesh"], sort=False):
            found = _searched(runs, plan) if levels.size else metrics(runs)
            ranked = rankings(runs, found, ", ".join(where), levels.tolist())
            sections.append(Section(title, where[1], dataset, runs, ranked))
    return sections


def _searched(runs: pd.DataFrame, plan: Mapping[str, Any]) -> list[Metric]:
    """Return the error for which a plan searched, at the last day; empty if no run has it."""
    kind, field = plan.get("target_kind", "auto"), plan.get("target_field", "h")
    kinds = ("total", "time") if kind == "auto" else (kind,)
    norm, field = plan.get("target_norm", "l2"), "vorticity" if kind == "slow" else field
    known = [of for of in runs if isinstance(of, Metric) and runs[of][runs.compared].notna().any()]
    found = [of for of in known if (of.kind in kinds and (of.field, of.norm) == (field, norm))]
    return sorted(found, key=lambda of: (kinds.index(of.kind), -of.day))[:1]


def slug(text: str) -> str:
    """Return a text as a part of file names and anchors."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


def run_table(runs: pd.DataFrame, short: bool = False) -> pd.DataFrame:
    """Return texts by title and row: essential columns and, unless `short`, others with a value."""
    known = read_toml(COLUMNS)
    errors = [
        {"title": f"{m.symbol} {m.kind}, day {m.day:g}", "name": m, "text": "error",
         "essential": True} for m in metrics(runs)
    ]  # fmt: skip
    shown = {}
    for column in (*known["settings"], *errors, *known["costs"]):
        values, essential = runs[column["name"]], column.get("essential", False)
        texts = values.map(getattr(words, column["text"]) if "text" in column else str)
        if essential or not (short or texts.isin(("", words.NOTHING)).all()):
            shown[column["title"]] = texts
    return pd.DataFrame(shown)


def write_report(
    datasets: Dataset | Mapping[str, Dataset], out: str | os.PathLike[str], *,
    recipe: Recipe | None = None,
) -> Path:  # fmt: skip
    """Write index.html and its figures (SVG) into a folder.

    datasets: what `sweep` returns, or several by name: a section each.
    recipe: its title and notes are shown, and README.md is written too, with its introduction.
    Returns the path of index.html.  Raises ConfigError for other datasets, and as `write_made`.
    """
    sections, notes = read_sections(datasets), recipe.notes if recipe else {}
    title = recipe.title if recipe else sections[0].dataset.attrs.get("title")
    files = {each.name: each.svg for of in sections for each in chain(*of.figures, of.others)}
    pages = {"index.html": "report.html.j2"} | ({"README.md": "page.md.j2"} if recipe else {})
    for name, template in pages.items():
        files[name] = rendered(
            "swe_sphere.studies.report", template, _link_rows, _attribute, _markdown, run_table,
            notes=notes, title=title or TITLE, sections=sections, recipe=recipe,
            repeatable=REPEATABLE,
        )  # fmt: skip
    write_made(Path(out), files)
    return Path(out) / "index.html"


def _markdown(text: str) -> Markup:
    """Return Markdown as HTML."""
    from markdown_it import MarkdownIt

    return Markup(MarkdownIt("commonmark", {"html": False}).enable("table").render(text))


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
