"""Standard streams that are closed or full: a lost result is an error, lost notes are not."""

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from swe_sphere.errors import RunFailed


class Results(io.TextIOWrapper):
    """Standard output: RunFailed where it cannot be written."""

    def write(self, text: str) -> int:
        """Write the text; return its length."""
        with self._reported():
            return super().write(text)

    def flush(self) -> None:
        """Write what is buffered."""
        with self._reported():
            super().flush()

    @contextmanager
    def _reported(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # or Python's own end fails once more
            raise RunFailed(f"cannot write to standard output: {error.strerror}") from None


class Notes(io.TextIOWrapper):
    """Standard error: what cannot be written is left out."""

    def write(self, text: str) -> int:
        """Write the text at once, as far as that works; return its length."""
        with suppress(OSError):
            super().write(text)
        self.flush()
        return len(text)

    def flush(self) -> None:
        """Write what is buffered as far as that works."""
        with suppress(OSError):
            super().flush()


def open_streams() -> None:
    """Give the streams that the caller closed their numbers, which else a file of the run gets.

    Text that the encoding lacks is written with escapes.  Streams that somebody has replaced stay.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_WRONLY if number == 2 else os.O_RDONLY)  # the lowest is free
    for name, number, kind in (("stdout", 1, Results), ("stderr", 2, Notes)):
        old = getattr(sys, f"__{name}__")
        if getattr(sys, name) is old:
            file = io.BufferedWriter(io.FileIO(number, "w", closefd=False))
            setattr(sys, name, kind(file, getattr(old, "encoding", "utf-8"), "backslashreplace"))
