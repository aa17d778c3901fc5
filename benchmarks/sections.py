"""Pages of several sections, of which each may be measured anew by itself."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
import warp as wp
from implicit_common import Section
from rich.console import Console
from rich.table import Table

from swe_sphere.files.fingerprints import machine

ROOT = Path(__file__).parents[1]
PAGES = ROOT / "docs" / "results"
DATA = ROOT / "benchmarks" / "results"


def command(
    page: str, head: str, sections: Mapping[str, Callable[[], Section]]
) -> Callable[..., None]:
    """Return the command of a script, which measures the named sections and writes their page."""

    def main(
        names: Annotated[list[str] | None, typer.Argument(help="Sections; all by default.")] = None,
        list_sections: Annotated[bool, typer.Option("--list", help="Print the sections.")] = False,
    ) -> None:
        """Run sections and rewrite the page."""
        if list_sections:
            typer.echo("\n".join(sections))
        else:
            write_page(page, head, sections, names or ())

    return main


def write_page(
    page: str, head: str, sections: Mapping[str, Callable[[], Section]], names: Sequence[str]
) -> None:
    """Run the named sections, all by default, and rewrite the page and its data.

    Sections that are not run keep what was measured before.  Ends with status 2, and with the
    names of the sections, where one is unknown.
    """
    console = Console(width=160)
    if unknown := [name for name in names if name not in sections]:
        console.print(f"unknown: {', '.join(unknown)}", *sections, sep="\n")
        raise typer.Exit(2)
    wp.config.log_level = wp.LOG_WARNING
    store = DATA / f"{page}.json"
    known = json.loads(store.read_text()) if store.exists() else {}
    for name in names or sections:
        section = sections[name]()
        console.print(_table(section))
        known[name] = vars(section) | {
            "machine": machine(),
            "measured": f"{datetime.now(UTC):%Y-%m-%d}, commit {_commit()}",
        }
        known = {key: known[key] for key in sections if key in known}
        store.write_text(json.dumps(known, indent=1, ensure_ascii=False) + "\n")
        (PAGES / f"{page}.md").write_text(_page(head, known))


def _commit() -> str:
    """Return the commit of the measured code, without what is not committed yet."""
    git = ["git", "log", "-1", "--format=%h"]
    return subprocess.run(git, cwd=ROOT, capture_output=True, text=True).stdout.strip()


def _table(section: Section) -> Table:
    table = Table(*section.columns, title=section.title)
    for row in section.rows:
        table.add_row(*row)
    return table


def _page(head: str, known: dict[str, dict[str, object]]) -> str:
    parts = [head]
    for name, section in known.items():
        lines = [f"## {section['title']}", "", str(section["note"]), ""]
        lines.append("| " + " | ".join(section["columns"]) + " |")
        lines.append("|" + "---|" * len(section["columns"]))
        lines += ["| " + " | ".join(row) + " |" for row in section["rows"]]
        if section.get("figure"):
            lines += ["", f"![{section['title']}]({section['figure']})"]
        lines += ["", f"Section `{name}`, {section['measured']}, {section['machine']}."]
        parts.append("\n".join(lines))
    return "\n\n".join(parts) + "\n"
