"""Plant every mutant, print who notices it, and write the page.

cd tests && python -m mutants [--no-write]
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer
import warp as wp
from rich.console import Console

from mutants import EDITS, STEP_EDITS, SWAPS
from mutants.kinds import ROOT, Mutant, copy_sources, verdict_of, verdict_of_tests

HEAD = """# Mutants

Does the quick verification (`swe-sphere verify --quick`) notice a single fault? Each line is one,
planted alone in the running program or in a copy of the sources, and the case and quantities out of
bounds because of it. Faults of the last three kinds (tolerance, variable step, metadata) do not
show in runs with fixed steps and tight solves: of these the test is named that fails.

Made by `cd tests && python -m mutants`; those of metric terms, quadrature weights, Coriolis
parameter, forcing and tableaus are planted by the tests too (`tests/test_mutants.py`).

**{caught} of {count} are caught ({part:.1%}).** {survivors}
"""


def main(write: Annotated[bool, typer.Option(help="Write the page.")] = True) -> None:
    """Plant them all."""
    wp.config.log_level = wp.LOG_WARNING
    console, found = Console(markup=False, highlight=False), []
    for mutant, notice in _all():
        console.print(f"{mutant.name}: {notice or 'SURVIVES'}", style="" if notice else "bold red")
        found.append((mutant, notice))
    if write:
        (ROOT / "docs" / "results" / "mutants.md").write_text(_page(found), encoding="utf-8")


def _all() -> Iterator[tuple[Mutant, str | None]]:
    for swap in SWAPS:
        yield swap, swap.caught()
    with tempfile.TemporaryDirectory() as folder:
        copy = copy_sources(Path(folder))
        asked = tuple(dict.fromkeys(name for edit in EDITS for name in edit.cases))
        if blamed := verdict_of(copy, asked):
            raise SystemExit(f"the sources fail without any mutant: {blamed}")
        tests = tuple(dict.fromkeys(name for edit in STEP_EDITS for name in edit.cases))
        if blamed := verdict_of_tests(copy, tests):
            raise SystemExit(f"a test fails without any mutant: {blamed}")
        for edit in (*EDITS, *STEP_EDITS):
            yield edit, edit.caught(copy)


def _page(found: list[tuple[Mutant, str | None]]) -> str:
    survivors = [mutant.name for mutant, notice in found if notice is None]
    caught = len(found) - len(survivors)
    told = f"Survivors: {'; '.join(survivors)}." if survivors else "There are no survivors."
    head = HEAD.format(caught=caught, count=len(found), part=caught / len(found), survivors=told)
    lines = ["| fault | where | noticed by |", "|---|---|---|"]
    for mutant, notice in found:
        lines.append(f"| {mutant.name} | `{mutant.where}` | {notice or '**nothing**'} |")
    return head + "\n" + "\n".join(lines) + "\n"


if __name__ == "__main__":
    typer.run(main)
