"""One sweep at a time in a folder."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from swe_sphere.durable import take_lock
from swe_sphere.errors import ConfigError

__all__ = ["alone"]


@contextmanager
def alone(journal: Path) -> Iterator[None]:
    """Hold a journal within the block; however the process ends, the system lets go of it.

    Reading it stays possible.  Where the system or the file system has no locks, nothing is held.

    Raises:
        ConfigError: another sweep holds it, or it cannot be written to.
    """
    try:
        file = journal.open("ab")
    except OSError as error:
        raise ConfigError(f"out: cannot write {journal}: {error.strerror}") from None
    with file:
        if not take_lock(file.fileno()):
            raise ConfigError(
                f"out: another sweep is at work in {journal.parent}: wait for its end, or choose"
                " another folder"
            )
        yield

