"""Output of commands on the terminal: tables, a line of progress, and errors in one line."""

import sys
from collections.abc import Iterable, Sequence
from typing import Any

import typer

from swe_sphere.errors import SweError, in_one_line
from swe_sphere.simulation.loop import Interrupted

DEBUG = "SWE_SPHERE_DEBUG"
"""Environment variable that shows the traceback of an error."""


def show_line(text: str) -> None:
    """Put the text into the last line of a terminal, replacing the previous text."""
    if sys.stderr.isatty():
        sys.stderr.write(f"\r\x1b[K{text}")


def print_table(heads: Sequence[str], lines: Iterable[Iterable[str]], **look: Any) -> None:
    """Print a table as wide as its cells: in a narrower terminal its lines wrap.

    look: options of rich.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Column, Table

    columns = [Column(head, no_wrap=True) for head in heads]
    table = Table(*columns, box=box.SIMPLE_HEAD, pad_edge=False, padding=0, **look)
    for line in lines:
        table.add_row(*line)
    Console(width=10_000, markup=False, highlight=False).print(table)


def explain(error: Exception) -> tuple[str, int]:
    """Return the message to the user, in one line, and the exit status."""
    hint, status = f"({DEBUG}=1 shows where)", 1
    if isinstance(error, SweError):
        line, status = str(error), error.exit_status
    elif isinstance(error, Interrupted):
        line, status = str(error), 130
    elif isinstance(error, typer.TyperException):
        line, status = f"{error.format_message()} (see swe-sphere --help)", error.exit_code
    elif isinstance(error, MemoryError):
        line = f"not enough memory: take a smaller mesh {hint}"
    else:
        line = f"unexpected {type(error).__name__}: {error} {hint}"
    return in_one_line(line), status
