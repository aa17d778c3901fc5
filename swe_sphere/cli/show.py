"""Output of commands: tables, a line of progress, errors in one line, and the standard streams.

A lost result is an error, lost notes are not.
"""

import io
import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from typing import Any

import typer

from swe_sphere.errors import Interrupted, RunFailed, SweError, in_one_line

DEBUG = "SWE_SPHERE_DEBUG"
"""Environment variable that shows the traceback of an error."""


def show_line(text: str) -> None:
    """Put the text into the last line of a terminal, replacing the previous text."""
    if sys.stderr.isatty():
        sys.stderr.write(f"\r\x1b[K{text}")


def print_table(heads: Sequence[str], lines: Iterable[Iterable[str]], **look: Any) -> None:
    """Print a table as wide as its cells; lines of narrower terminals wrap. look: as for rich."""
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
    if isinstance(error, SweError | Interrupted):
        line, status = str(error), error.exit_status
    elif isinstance(error, typer.TyperException):
        line, status = error.format_message(), error.exit_code  # empty if the help was asked for
        line += " (see swe-sphere --help)" if line else ""
    elif isinstance(error, MemoryError):
        line = f"not enough memory: take a smaller mesh {hint}"
    elif isinstance(error, UnicodeEncodeError):
        name, status = ascii(error.object), 2
        line = f"{name} is not in the encoding {error.encoding}: choose another, or LC_ALL=C.UTF-8"
    else:
        line = f"unexpected {type(error).__name__}: {error} {hint}"
    return in_one_line(line), status


class Notes(io.TextIOWrapper):
    """Standard error without buffering: text that cannot be written is dropped."""

    def write(self, text: str) -> int:
        """Write the text; return its length."""
        with self._checked():
            super().write(text)
            super().flush()
        return len(text)

    def flush(self) -> None:
        with self._checked():
            super().flush()

    def _checked(self) -> AbstractContextManager[None]:
        return suppress(OSError)


class Results(Notes):
    """Standard output without buffering: raises RunFailed if it cannot be written."""

    @contextmanager
    def _checked(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # or Python's flush at exit fails too
            raise RunFailed(f"cannot write to standard output: {error.strerror}") from None


def open_streams() -> None:
    """Open the streams that the caller closed, so that no file of the run gets their numbers.

    Characters that the encoding lacks are written as escapes. Replaced streams are not changed.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_WRONLY if number == 2 else os.O_RDONLY)  # the lowest free one
    for name, number, kind in (("stdout", 1, Results), ("stderr", 2, Notes)):
        old = getattr(sys, f"__{name}__")
        if getattr(sys, name) is old:
            file = io.BufferedWriter(io.FileIO(number, "w", closefd=False))
            setattr(sys, name, kind(file, getattr(old, "encoding", "utf-8"), "backslashreplace"))
