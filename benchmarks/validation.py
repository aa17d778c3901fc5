"""Run the validation table, print required against obtained, and write docs/validation.md.

    python benchmarks/validation.py              all rows
    python benchmarks/validation.py williamson5-ne16np4 cost
    python benchmarks/validation.py --list

Rows that are not run keep what was measured before (docs/validation.json).  Exit status 1 when a
number that was run is out of its bounds.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer
import warp as wp
from cases import ROWS, Check, Result
from rhs_cost import machine
from rich.console import Console
from rich.table import Table

DOCS = Path(__file__).parents[1] / "docs"
HEAD = """# Validation

What the model must show and what it shows, measured with `python benchmarks/validation.py`
(float64, one core, no dissipation unless said).  Errors are the normalised norms of Williamson et
al. (1992); references and their own uncertainties are in `tests/data`.  Wall time is that of the
steps alone.  Where nothing is required, the number is told for comparison.
"""


def main(
    names: Annotated[list[str] | None, typer.Argument(help="Rows to run; all by default.")] = None,
    list_rows: Annotated[bool, typer.Option("--list", help="Print the names of the rows.")] = False,
) -> None:
    """Run rows of the table and rewrite the page."""
    console = Console(width=140)
    unknown = [name for name in names or () if name not in ROWS]
    if list_rows or unknown:
        console.print(f"unknown: {', '.join(unknown)}" if unknown else "", *ROWS, sep="\n")
        raise typer.Exit(2 if unknown else 0)
    wp.config.log_level = wp.LOG_WARNING
    store = DOCS / "validation.json"
    known = json.loads(store.read_text())["rows"] if store.exists() else {}
    failed = False
    for name in names or ROWS:
        result = ROWS[name]()
        known[name] = _plain(result)
        failed |= any(check.passed is False for check in result.checks)
        _print(console, name, result)
        ordered = {key: known[key] for key in ROWS if key in known}
        store.write_text(json.dumps({"rows": ordered}, indent=1, ensure_ascii=False) + "\n")
        (DOCS / "validation.md").write_text(_page(ordered))
    raise typer.Exit(1 if failed else 0)


def _plain(result: Result) -> dict[str, Any]:
    checks = [asdict(check) | {"passed": check.passed} for check in result.checks]
    day = datetime.now(UTC).strftime("%Y-%m-%d")
    return asdict(result) | {"checks": checks, "measured": day, "machine": machine()}


def _print(console: Console, name: str, result: Result) -> None:
    table = Table("quantity", "required", "obtained", title=f"{name}: {result.setting}")
    for check in result.checks:
        style = {True: "green", False: "bold red", None: ""}[check.passed]
        table.add_row(check.quantity, _required(asdict(check)), _number(check), style=style)
    console.print(table)


def _number(check: Check) -> str:
    return f"{check.obtained:.3g}"


def _required(check: dict[str, Any]) -> str:
    if check["limit"] is not None:
        return f"≤ {check['limit']:.4g}"
    return "" if check["floor"] is None else f"≥ {check['floor']:.4g}"


def _page(rows: dict[str, Any]) -> str:
    lines = ["| run | quantity | required | obtained | |", "|---|---|---|---|---|"]
    marks = {True: "✓", False: "**missed**", None: ""}
    notes = []
    for name, row in rows.items():
        title = f"`{name}`: {row['setting']}" + (
            f" ({row['seconds']:.1f} s)" if row["seconds"] else ""
        )
        for check in row["checks"]:
            obtained = f"{check['obtained']:.3g}" if math.isfinite(check["obtained"]) else "-"
            cells = (title, check["quantity"], _required(check), obtained, marks[check["passed"]])
            lines.append("| " + " | ".join(cells) + " |")
            title = ""
        notes += [f"* `{name}`: {note}." for note in row["notes"]]
    machines = sorted({f"* {row['machine']} ({row['measured']})" for row in rows.values()})
    parts = [
        HEAD,
        "\n".join(lines),
        "## Notes",
        "\n".join(notes),
        "## Machine",
        "\n".join(machines),
    ]
    return "\n\n".join(part.strip() for part in parts) + "\n"


if __name__ == "__main__":
    typer.run(main)
