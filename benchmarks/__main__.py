"""Make the result pages of the documentation again.

    python -m benchmarks --list           print all parts and when they were made
    python -m benchmarks                  make all parts that were not made with the current commit
    python -m benchmarks steps implicit   make these parts, in any case

Parts run one after the other, each in a process of its own. A part that has finished is recorded in
benchmarks/results/measured.json with commit, machine and date, so that the same command resumes
after an interrupt.
"""

from __future__ import annotations

import json
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, NamedTuple

import typer
from rich.console import Console
from rich.table import Table

from swe_sphere.files.fingerprints import machine

ROOT = Path(__file__).parents[1]
RECORD = ROOT / "benchmarks" / "results" / "measured.json"


class Part(NamedTuple):
    """Arguments of Python that make a page of the documentation."""

    command: str
    page: str


PARTS = {
    "verification": Part(
        "-m swe_sphere verify --out docs/results/verification.md",
        "results/verification"),
    "stability": Part(
        "-m swe_sphere stress --out docs/results/stability.md",
        "results/stability"),
    "evans2010": Part(
        "-m swe_sphere sweep --recipe evans2010 --out docs/results/evans2010",
        "results/evans2010/README"),
    "regimes": Part("-m swe_sphere sweep --recipe regimes --out docs/regimes", "regimes/README"),
    "effects": Part(
        "benchmarks/effect_cost.py --write docs/reference/effects.md", "reference/effects"),
    "diffusion": Part(
        "benchmarks/diffusion.py --write docs/explanation/time_integration.md",
        "explanation/time_integration"),
    "steps": Part("benchmarks/steps.py", "results/steps"),
    "step_sizes": Part("benchmarks/step_sizes.py", "results/step_sizes"),
    "imex_steps": Part("benchmarks/imex_steps.py", "results/imex_steps"),
    "implicit": Part("benchmarks/implicit.py", "results/implicit"),
    "off_axis": Part("benchmarks/off_axis.py", "results/off_axis"),
    "transport": Part("benchmarks/transport.py", "results/transport"),
    "tracer_steps": Part(
        "benchmarks/tracer_steps.py --write docs/results/tracer_steps.md",
        "results/tracer_steps"),
    "performance": Part("benchmarks/kernel_bound.py --write docs/results", "results/performance"),
    "gpu": Part("benchmarks/gpu.py", "results/gpu"),
    "scaling": Part("benchmarks/scaling.py", "results/scaling"),
    "start-up": Part("benchmarks/start_up.py", "results/start-up"),
    "peers": Part("benchmarks/time_to_error.py", "results/peers"),
    "gallery": Part("benchmarks/gallery.py", "reference/scenes"),
}  # fmt: skip
"""All parts by name, in the order in which they run."""

console = Console()


def main(
    names: Annotated[list[str] | None, typer.Argument(help="Parts; by default all.")] = None,
    list_parts: Annotated[bool, typer.Option("--list", help="Print the parts.")] = False,
) -> None:
    """Make the result pages of the documentation again."""
    if unknown := sorted({*(names or ())} - {*PARTS}):
        raise typer.BadParameter(f"unknown: {', '.join(unknown)}; parts: {', '.join(PARTS)}")
    made = json.loads(RECORD.read_text()) if RECORD.exists() else {}
    if list_parts:
        console.print(_table(made))
        return
    commit = _commit()
    for name in names or [n for n in PARTS if made.get(n, {}).get("commit") != commit]:
        console.rule(name)
        ended = subprocess.run(
            [sys.executable, *PARTS[name].command.split()], cwd=ROOT, check=False
        )
        if ended.returncode:
            raise typer.Exit(ended.returncode)
        made[name] = {
            "commit": commit,
            "machine": machine(),
            "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        }
        RECORD.write_text(json.dumps(made, indent=1, ensure_ascii=False) + "\n")


def _commit() -> str:
    """Return the commit of the sources, with a + where they have been changed since."""
    answers = [
        subprocess.run(
            ["git", *words.split()], cwd=ROOT, capture_output=True, text=True, check=True
        )
        for words in ("rev-parse --short HEAD", "status --porcelain kernels testcases swe_sphere")
    ]
    commit, changes = (answer.stdout.strip() for answer in answers)
    return f"{commit}+" if changes else commit


def _table(made: dict[str, dict[str, str]]) -> Table:
    table = Table("part", "page", "made with", "on")
    for name, part in PARTS.items():
        record = made.get(name, {})
        table.add_row(name, f"docs/{part.page}.md", record.get("commit", ""),
                      record.get("date", ""))  # fmt: skip
    return table


if __name__ == "__main__":
    typer.run(main)
