"""Tables that scripts measure, stored in benchmarks/results and shown by the pages of results.

A file of `benchmarks/results` holds the sections of one script.  Each section is a table with its
title, its note, and a stamp: commit and fingerprint of the code, machine, date and duration.
"""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer
import warp as wp
from rich.console import Console
from rich.table import Table

from swe_sphere.files.fingerprints import code_fingerprint, processor, versions

ROOT = Path(__file__).parents[1]
PAGES = ROOT / "docs" / "results"
DATA = ROOT / "benchmarks" / "results"


@dataclass
class Section:
    """A measured table."""

    title: str
    note: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]


Measure = Callable[[], Section]
Sections = dict[str, dict[str, Any]]
"""Sections of a file of `benchmarks/results` by name."""


def command(name: str, sections: Mapping[str, Measure]) -> Callable[..., None]:
    """Return the command of a script that measures sections of `benchmarks/results/NAME.json`."""

    def main(
        names: Annotated[
            list[str] | None,
            typer.Argument(help="Sections; by default those not measured with the current code."),
        ] = None,
        list_sections: Annotated[bool, typer.Option("--list", help="Print the sections.")] = False,
    ) -> None:
        """Measure sections and store them."""
        if list_sections:
            typer.echo("\n".join(sections))
        else:
            measure(name, sections, names or ())

    return main


def measure(name: str, sections: Mapping[str, Measure], names: Sequence[str] = ()) -> None:
    """Measure the named sections and store each as soon as it is finished.

    By default those are measured that were not measured with the current code on a machine of this
    kind, so that the same command resumes after an interrupt.  An unknown name ends the program
    with status 2 and the names of all sections.
    """
    console = Console(width=160)
    if unknown := [each for each in names if each not in sections]:
        console.print(f"unknown: {', '.join(unknown)}", *sections, sep="\n")
        raise typer.Exit(2)
    wp.config.log_level = wp.LOG_WARNING
    known = load(name)
    for each in names or [key for key in sections if not is_current(known.get(key, {}))]:
        began = time.perf_counter()
        section = sections[each]()
        console.print(_printable(section))
        known[each] = vars(section) | stamp(time.perf_counter() - began)
        store(name, {key: known[key] for key in sections if key in known})


def load(name: str) -> Sections:
    """Return the sections of `benchmarks/results/NAME.json`; none if there is no such file."""
    file = DATA / f"{name}.json"
    found: Sections = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    return found


def store(name: str, sections: Sections) -> None:
    """Write `benchmarks/results/NAME.json`, each row of a table on a line."""
    text = json.dumps(sections, ensure_ascii=False).replace("], [", "],\n[")
    (DATA / f"{name}.json").write_text(text.replace('}, "', '},\n"') + "\n", encoding="utf-8")


def machine() -> str:
    """Return processor, number of cores, and versions of Python and Warp in a line."""
    found = versions()
    return f"{processor()}, {os.cpu_count()} cores; Python {found['python']}, Warp {found['warp']}"


def stamp(seconds: float = 0.0) -> dict[str, Any]:
    """Return the stamp of a measurement that ends now; seconds: its duration."""
    git = ["git", "log", "-1", "--format=%h"]
    commit = subprocess.run(git, cwd=ROOT, capture_output=True, text=True, check=False).stdout
    return {
        "commit": commit.strip(), "code": code_fingerprint(), "machine": machine(),
        "date": f"{datetime.now(UTC):%Y-%m-%d}", "minutes": round(seconds / 60.0, 1),
    }  # fmt: skip


def stamp_text(of: Mapping[str, Any]) -> str:
    """Return date, commit, code and machine of a measurement as pages state them."""
    code = f"code `{of['code']}`" if of["code"] else EARLIER
    return f"{of['date']}, commit {of['commit']}, {code}; {of['machine'] or 'no machine recorded'}."


EARLIER = "code of an earlier version"
"""Text of the pages for measurements that were stored without a fingerprint of their code."""


def is_current(stamped: Mapping[str, Any]) -> bool:
    """Return whether a section was measured with the current code on such a machine."""
    return (stamped.get("code"), stamped.get("machine")) == (code_fingerprint(), machine())


def _printable(section: Section) -> Table:
    table = Table(*section.columns, title=section.title)
    for row in section.rows:
        table.add_row(*map(str, row))
    return table
