"""Pages of results, filled in from their templates and from the tables of benchmarks/results.

`python -m benchmarks --pages` writes all of them.  A template in benchmarks/pages holds the text of
a page: the finding, figures, one table, folded full tables, and how it was measured.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import resolution
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from sections import DATA, PAGES, load, stamp_text

from swe_sphere.studies.cases import Measure, Row, choose, page

TEMPLATES = Path(__file__).with_name("pages")
COMMANDS = {"verification": "verify", "stability": "stress"}


def render() -> dict[Path, str]:
    """Return the text of every page of results by its file, without figures."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES), undefined=StrictUndefined, trim_blocks=True,
        keep_trailing_newline=True,
    )  # fmt: skip
    environment.globals.update(table=table, folded=folded, stamp=stamp, cases=cases, load=load)
    names = sorted(path.name.removesuffix(".md.j2") for path in TEMPLATES.glob("*.md.j2"))
    made = {
        PAGES / f"{name}.md": environment.get_template(f"{name}.md.j2").render() for name in names
    }
    return made | {resolution.PAGE: resolution.stored_page()}


def table(
    name: str,
    section: str,
    columns: Sequence[str] | None = None,
    where: Mapping[str, Sequence[str]] | None = None,
) -> str:
    """Return a section of `benchmarks/results/NAME.json` as a table in Markdown.

    columns: columns that are shown; by default all.  where: values of columns that rows must have.
    """
    of = load(name)[section]
    heads, rows = list(of["columns"]), of["rows"]
    for column, values in (where or {}).items():
        rows = [row for row in rows if row[heads.index(column)] in values]
    at = [heads.index(column) for column in columns or heads] if columns else range(len(heads))
    lines = [[heads[i] for i in at], ["---" for _ in at], *([row[i] for i in at] for row in rows)]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)


def folded(name: str, section: str, note: str = "") -> str:
    """Return a section as a folded table with its note and stamp; note: replaces its note."""
    of = load(name)[section]
    parts = [
        f"<details><summary>{of['title']}</summary>", note or of["note"], table(name, section),
        stamp(name, section), "</details>",
    ]  # fmt: skip
    return "\n\n".join(part for part in parts if part)


def stamp(name: str, section: str) -> str:
    """Return where a section is stored, and date, commit, code and machine of its measurement."""
    text = stamp_text(load(name)[section])
    return f"Section `{section}` of `benchmarks/results/{name}.json`: {text}"


def cases(folder: str) -> str:
    """Return the page of "verification" or "stability", made of its stored numbers.

    Without stored numbers the page is returned as the command wrote it.
    """
    if not (DATA / f"{folder}.csv").exists():
        return (PAGES / f"{folder}.md").read_text(encoding="utf-8").partition(MORE)[0].rstrip("\n")
    command = f"swe-sphere {COMMANDS[folder]} --out docs/results/{folder}.md"
    text = page(folder, rows_of(folder), command).rstrip("\n")
    with (DATA / f"{folder}.csv").open(encoding="utf-8") as file:
        measured = json.loads(next(file).removeprefix("# "))
    stamped = f"* `benchmarks/results/{folder}.csv`: {stamp_text(measured)}"
    return re.sub(r"^\* Python .*$", lambda _: stamped, text, flags=re.MULTILINE)


def rows_of(folder: str) -> list[Row]:
    """Return the rows of "verification" or "stability" from `benchmarks/results/FOLDER.csv`."""
    with (DATA / f"{folder}.csv").open(encoding="utf-8") as file:
        next(file)  # commit, machine and date
        lines = list(csv.DictReader(file))
    rows: list[Row] = []
    known = iter(choose(folder))
    for line in lines:
        numbers = {key: float(value) for key, value in line.items() if value and key not in TEXTS}
        case = next(case for case in known if case.name == line["name"])
        before = rows[-1] if rows and rows[-1].case.name == case.name else None
        measure = Measure(
            fingerprint="", name=line["name"], status=line["status"], reason=line["message"],
            numbers=numbers,
        )  # fmt: skip
        rows.append(Row(case, measure, before))
    return rows


MORE = "<!-- more by python -m benchmarks -->"
"""Line in pages of cases before the text that `swe-sphere verify` or `stress` does not write."""
TEXTS = ("name", "status", "message")
"""Columns of `benchmarks/results/*.csv` that are not numbers."""
