"""Measure the results of the documentation again, and write their pages.

    python -m benchmarks --list              print the parts, their duration and their last stamp
    python -m benchmarks                     measure what was not measured with the current code
    python -m benchmarks performance peers   the same for these parts
    python -m benchmarks --pages             only write the pages, from the stored tables

Parts run one after the other, each script in a separate process.  A script stores each section
in `benchmarks/results` as soon as it is finished, so that the same command resumes after an
interrupt.
"""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parent))

from pages import TEXTS, render
from resolution import PAGE, figures, read_table
from sections import DATA, PAGES, ROOT, is_current, load, stamp


class Part(NamedTuple):
    """Page of the documentation, with the scripts that measure its tables."""

    page: str
    """File in `docs` without its ending."""
    duration: str
    """Approximate duration of the part; empty if it has not been timed."""
    scripts: tuple[str, ...]
    """Arguments of one Python process each, run one after the other."""
    tables: tuple[str, ...] = ()
    """Files of `benchmarks/results` that the scripts write."""


PARTS = {
    "verification": Part(
        "results/verification", "10 minutes",
        ("-m swe_sphere verify --out docs/results/verification.md", "-m mutants"),
        ("verification", "mutants"),
    ),
    "stability": Part(
        "results/stability", "1.5 hours",
        ("-m swe_sphere stress --out docs/results/stability.md", "benchmarks/off_axis.py"),
        ("stability", "off_axis"),
    ),
    "evans2010": Part(
        "results/evans2010/README", "3 hours",
        ("-m swe_sphere sweep --recipe evans2010 --out docs/results/evans2010",),
    ),
    "resolution": Part(
        "results/resolution/README", "",
        ("-m swe_sphere sweep --recipe benchmarks/resolution.toml --out build/resolution",
         "benchmarks/resolution.py build/resolution", "benchmarks/break_even.py"),
        ("resolution", "break_even"),
    ),
    "steps": Part(
        "results/steps", "1 hour",
        ("benchmarks/steps.py", "benchmarks/imex_steps.py", "benchmarks/step_sizes.py"),
        ("steps", "imex_steps", "step_sizes"),
    ),
    "implicit": Part("results/implicit", "", ("benchmarks/implicit.py",), ("implicit",)),
    "transport": Part(
        "results/verification", "", ("benchmarks/transport.py", "benchmarks/tracer_steps.py"),
        ("transport", "tracer_steps"),
    ),
    "performance": Part(
        "results/performance", "",
        ("benchmarks/kernel_bound.py", "benchmarks/memory.py", "benchmarks/start_up.py",
         "benchmarks/versions.py"),
        ("performance", "memory", "start_up", "versions"),
    ),
    "scaling": Part(
        "results/performance", "", ("benchmarks/gpu.py", "benchmarks/scaling.py"),
        ("gpu", "scaling"),
    ),
    "peers": Part("results/peers", "", ("benchmarks/time_to_error.py",), ("peers",)),
    "effects": Part(
        "reference/effects", "",
        ("benchmarks/effect_cost.py --write docs/reference/effects.md",),
    ),
    "diffusion": Part(
        "explanation/time_integration", "",
        ("benchmarks/diffusion.py --write docs/explanation/time_integration.md",),
    ),
    "gallery": Part(
        "reference/scenes", "some minutes", ("benchmarks/gallery.py", "benchmarks/papers.py"),
    ),
}  # fmt: skip
"""All parts by name, in the order in which they run."""
CASES = ("verification", "stability")
"""Parts whose first command writes rows of cases, stored as `benchmarks/results/*.csv`."""


def main(
    names: Annotated[list[str] | None, typer.Argument(help="Parts; by default all.")] = None,
    list_parts: Annotated[bool, typer.Option("--list", help="Print the parts.")] = False,
    only_pages: Annotated[bool, typer.Option("--pages", help="Measure nothing.")] = False,
) -> None:
    """Measure the results of the documentation again, and write their pages."""
    if unknown := sorted({*(names or ())} - {*PARTS}):
        raise typer.BadParameter(f"unknown: {', '.join(unknown)}; parts: {', '.join(PARTS)}")
    if list_parts:
        Console(width=120).print(_listed())
        return
    for name in () if only_pages else names or PARTS:
        for script in PARTS[name].scripts:
            _run(name, script)
    drawn = {PAGE.with_name(name): text for name, text in figures(read_table()).items()}
    for path, text in (render() | drawn).items():
        path.write_text(text, encoding="utf-8")


def _run(name: str, script: str) -> None:
    """Run a script of a part, unless its stored results are those of the current code."""
    cases = name in CASES and script == PARTS[name].scripts[0]
    if cases and is_current(cases_stamp(name)):
        return
    if "mutants" in script and is_current(load("mutants").get("faults", {})):
        return
    page, runs = PAGES / f"{name}.md", PAGES / f"{name}.runs"
    words = script.split() + (["--resume"] if cases and runs.exists() else [])
    Console().rule(f"{name}: python {' '.join(words)}")
    if cases and not runs.exists():
        page.unlink(missing_ok=True)
    began = time.perf_counter()
    folder = ROOT / "tests" if "mutants" in script else ROOT
    ended = subprocess.run([sys.executable, *words], cwd=folder, check=False)
    numbers = page.with_suffix(".json")
    if cases and numbers.exists():
        store_cases(name, numbers, time.perf_counter() - began)
    if ended.returncode:
        raise typer.Exit(ended.returncode)


def cases_stamp(name: str) -> dict[str, Any]:
    """Return the stamp of `benchmarks/results/NAME.csv`, empty if there is no such file."""
    file = DATA / f"{name}.csv"
    first = file.open(encoding="utf-8").readline() if file.exists() else "# {}"
    found: dict[str, Any] = json.loads(first.removeprefix("# "))
    return found


def store_cases(name: str, numbers: Path, seconds: float) -> None:
    """Move the numbers of `swe-sphere verify` or `stress` to `benchmarks/results/NAME.csv`."""
    found = json.loads(numbers.read_text(encoding="utf-8"))
    rows = [_flat(row) for row in found.get("rows") or found["results"]]
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with (DATA / f"{name}.csv").open("w", encoding="utf-8", newline="") as file:
        file.write(f"# {json.dumps(stamp(seconds))}\n")
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    numbers.unlink()


def _flat(row: Mapping[str, Any]) -> dict[str, str]:
    """Return a row of `swe-sphere verify --json` or `stress --json` as cells by column."""
    texts = row.get("case") or row["name"], row["status"], row["reason"] or ""
    if "numbers" in row:
        numbers, texts = row["numbers"], (*texts[:2], row["stopped"])
    else:
        numbers = {"dt": row["dt"], "step_seconds": row["seconds"]} | row["quantities"]
    cells = {key: "nan" if x is None else f"{x:.10g}" for key, x in numbers.items()}
    return dict(zip(TEXTS, texts, strict=True)) | cells


def _listed() -> Table:
    table = Table("part", "page", "takes about", "table", "measured", "commit", "code")
    for name, part in PARTS.items():
        head = [name, f"docs/{part.page}.md", part.duration or "not timed"]
        for each in part.tables or ("",):
            if each in CASES:
                stamps = [cases_stamp(each)]
            else:
                stamps = [*load(each).values()] if each else []
            stamps = [of for of in stamps if of]
            code = "current" if all(map(is_current, stamps)) else "older"
            dates = sorted({of["date"] for of in stamps})
            when = " to ".join(dict.fromkeys((dates[0], dates[-1]))) if dates else "never"
            commits = ", ".join(dict.fromkeys(of["commit"] for of in stamps))
            table.add_row(*head, each, *((when, commits, code) if stamps else ()))
            head = ["", "", ""]
    return table


if __name__ == "__main__":
    typer.run(main)
