"""Measure implicit and exponential steppers and preconditioners, and write docs/implicit.md.

    python benchmarks/implicit.py              all sections
    python benchmarks/implicit.py counts price
    python benchmarks/implicit.py --list

Sections that are not run keep what was measured before (docs/implicit.json).
"""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
import warp as wp
from exponential_runs import exponential, exponential_steps
from implicit_common import Section
from implicit_newton import newton
from implicit_runs import drift, race
from implicit_solver import counts, long_steps, price, steady
from rich.console import Console
from rich.table import Table

from swe_sphere.machine import machine

DOCS = Path(__file__).parents[1] / "docs"
SECTIONS = {
    "counts": counts,
    "price": price,
    "newton": newton,
    "race": race,
    "steady": steady,
    "drift": drift,
    "long-steps": long_steps,
    "exponential": exponential,
    "exponential-steps": exponential_steps,
}
HEAD = """# Implicit and exponential steppers, measured

Made by `python benchmarks/implicit.py` (float64, one core).  A right-hand-side equivalent is the
time of one right-hand side with DSS in the same process; wall time is that of the steps alone,
set-up of the preconditioner included, compilation not.  l2 is that of the surface height against
the independent spectral reference unless said.  What was tried and what was learnt is told in
[preconditioners](preconditioners.md).
"""


def main(
    names: Annotated[list[str] | None, typer.Argument(help="Sections; all by default.")] = None,
    list_sections: Annotated[bool, typer.Option("--list", help="Print the sections.")] = False,
) -> None:
    """Run sections and rewrite the page."""
    console = Console(width=160)
    unknown = [name for name in names or () if name not in SECTIONS]
    if list_sections or unknown:
        console.print(f"unknown: {', '.join(unknown)}" if unknown else "", *SECTIONS, sep="\n")
        raise typer.Exit(2 if unknown else 0)
    wp.config.log_level = wp.LOG_WARNING
    store = DOCS / "implicit.json"
    known = json.loads(store.read_text()) if store.exists() else {}
    for name in names or SECTIONS:
        section = SECTIONS[name]()
        console.print(_table(section))
        known[name] = vars(section) | {
            "machine": machine(),
            "measured": datetime.now(UTC).strftime("%Y-%m-%d"),
        }
        known = {key: known[key] for key in SECTIONS if key in known}
        store.write_text(json.dumps(known, indent=1, ensure_ascii=False) + "\n")
        (DOCS / "implicit.md").write_text(_page(known))


def _table(section: Section) -> Table:
    table = Table(*section.columns, title=section.title)
    for row in section.rows:
        table.add_row(*row)
    return table


def _page(known: dict[str, dict[str, object]]) -> str:
    parts = [HEAD]
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


if __name__ == "__main__":
    typer.run(main)
