"""Plant every mutant, print which check detects it, and store the table.

cd tests && python -m mutants [--no-write]
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer
import warp as wp
from rich.console import Console

from mutants import EDITS, RESULT_EDITS, STEP_EDITS, SWAPS
from mutants.kinds import ROOT, Mutant, copy_sources, verdict_of, verdict_of_tests

sys.path.append(str(ROOT / "benchmarks"))

from sections import Section, stamp, store

TABLE = "Single faults, and the check that detects each"


def main(write: Annotated[bool, typer.Option(help="Store the table.")] = True) -> None:
    """Plant them all."""
    wp.config.log_level = wp.LOG_WARNING
    began = time.perf_counter()
    console, found = Console(markup=False, highlight=False), []
    for mutant, notice in _all():
        console.print(f"{mutant.name}: {notice or 'SURVIVES'}", style="" if notice else "bold red")
        found.append((mutant, notice))
    if write:
        rows = [[m.name, f"`{m.where}`", notice or "**nothing**"] for m, notice in found]
        section = Section(TABLE, "", ["fault", "where", "detected by"], rows)
        store("mutants", {"faults": vars(section) | stamp(time.perf_counter() - began)})


def _all() -> Iterator[tuple[Mutant, str | None]]:
    for swap in SWAPS:
        yield swap, swap.caught()
    with tempfile.TemporaryDirectory() as folder:
        copy = copy_sources(Path(folder))
        asked = tuple(dict.fromkeys(name for edit in EDITS for name in edit.cases))
        if blamed := verdict_of(copy, asked):
            raise SystemExit(f"the sources fail without any mutant: {blamed}")
        tests = tuple(
            dict.fromkeys(name for edit in (*STEP_EDITS, *RESULT_EDITS) for name in edit.cases)
        )
        if blamed := verdict_of_tests(copy, tests):
            raise SystemExit(f"a test fails without any mutant: {blamed}")
        for edit in (*EDITS, *STEP_EDITS, *RESULT_EDITS):
            yield edit, edit.caught(copy)


if __name__ == "__main__":
    typer.run(main)
