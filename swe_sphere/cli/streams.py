"""Standard streams that may be closed or full: a lost result is an error, a lost note is not."""

import io
import os
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress

from swe_sphere.errors import RunFailed


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
            os.open(os.devnull, os.O_WRONLY if number == 2 else os.O_RDONLY)  # the lowest is free
    for name, number, kind in (("stdout", 1, Results), ("stderr", 2, Notes)):
        old = getattr(sys, f"__{name}__")
        if getattr(sys, name) is old:
            file = io.BufferedWriter(io.FileIO(number, "w", closefd=False))
            setattr(sys, name, kind(file, getattr(old, "encoding", "utf-8"), "backslashreplace"))
