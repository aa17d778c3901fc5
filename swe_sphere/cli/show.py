"""What commands show on the terminal: warnings, progress, tables, and errors in a line."""

from __future__ import annotations

import os
import shlex
import sys
import traceback
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Any

import typer

from swe_sphere.errors import SweError, in_one_line
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.observers import LogLines, Observer, ProgressBar
from swe_sphere.simulation.summary import Summary

GOES_ON = ("interrupted", "timed-out")
"""Ends after which a run can be gone on with."""
UNBOUNDED = 10_000
"""Columns that no table has."""


def progress(config: RunConfig) -> list[Observer]:
    """Return what shows the progress of a run: a bar in a terminal, lines elsewhere."""
    if config.quiet or config.as_json or config.live:
        return []
    return [ProgressBar() if sys.stderr.isatty() else LogLines()]


def show_warning(text: str) -> None:
    """Print a warning on stderr."""
    with suppress(OSError):  # nobody reads it any more
        sys.stderr.write(f"swe-sphere: warning: {text}\n")


def show_line(text: str) -> None:
    """Put the text into the last line of a terminal, in the place of what stood there."""
    if sys.stderr.isatty():
        sys.stderr.write(f"\r\x1b[K{text}")
        sys.stderr.flush()


def show_summary(summary: Summary, config: RunConfig) -> None:
    """The result as a table or a line of JSON; why it stopped early in one line on stderr."""
    if summary.reason is not None:
        named = config.out is None or str(config.out) in summary.reason
        kept = "" if named else f"; {config.out} keeps what was written"
        sys.stderr.write(f"swe-sphere: {in_one_line(summary.reason)}{kept}\n")
    told = config.out is not None and not (config.quiet or config.as_json)
    if told and summary.status in GOES_ON:
        words = ["swe-sphere", "run", config.scene, "--restart", str(config.out)]
        words += ["--out", str(config.out), "--days", f"{summary['days_planned']:.12g}"]
        sys.stderr.write(f"swe-sphere: it goes on with: {shlex.join(words)}\n")
    if config.as_json:
        sys.stdout.write(summary.as_json() + "\n")
    elif not config.quiet:
        _print_table(summary, config)


def _print_table(summary: Summary, config: RunConfig) -> None:
    from rich.console import Console
    from rich.table import Table

    files = {"frames": config.out, "picture": config.plot}
    written = [(name, str(path)) for name, path in files.items() if path is not None]
    table = Table(show_header=False, title=summary.title)
    for line in (*summary.rows(), *written):
        table.add_row(*line)
    Console(markup=False, highlight=False).print(table)


def print_table(heads: Sequence[str], lines: Iterable[Iterable[str]], **look: Any) -> None:
    """A table as wide as its cells: where the terminal is narrower, its lines wrap.

    look: as of rich.
    """
    from rich import box
    from rich.console import Console
    from rich.measure import measure_renderables
    from rich.table import Column, Table

    columns = [Column(head, no_wrap=True) for head in heads]
    table = Table(*columns, box=box.SIMPLE_HEAD, pad_edge=False, padding=0, **look)
    for line in lines:
        table.add_row(*line)
    console = Console(markup=False, highlight=False)
    wide = console.options.update(max_width=UNBOUNDED)
    console.width = max(console.width, measure_renderables(console, wide, [table]).maximum)
    console.print(table)


DEBUG = "SWE_SPHERE_DEBUG"
"""Environment variable that asks for the traceback of an error."""


class Stopped(SweError):
    """The user stopped the program before a run had begun."""

    exit_status = 130


def show_traceback() -> None:
    """Print where the error being handled came from, if the user asked for that."""
    if os.environ.get(DEBUG):
        traceback.print_exc()


def explain(error: Exception) -> tuple[str, int]:
    """Return the message to the user, in one line, and the exit status."""
    hint, status = f"({DEBUG}=1 shows where)", 1
    if isinstance(error, SweError):
        line, status = str(error), error.exit_status
    elif isinstance(error, typer.TyperException):
        line, status = f"{error.format_message()} (see swe-sphere --help)", error.exit_code
    elif isinstance(error, MemoryError):
        line = f"not enough memory: take a smaller mesh {hint}"
    else:
        line = f"unexpected {type(error).__name__}: {error} {hint}"
    return in_one_line(line), status
