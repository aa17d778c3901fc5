"""Files that a kill or a full disk at any moment leaves whole: the old one or the new one."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from swe_sphere.errors import RunFailed

__all__ = ["append_line", "sync_folder", "take_lock", "write_whole"]


def write_whole(path: Path, contents: str | bytes) -> None:
    """Write a file, and its folder if need be, on disk before this returns; text in UTF-8.

    The contents go to a file beside it, of a name that no other process takes, which then takes the
    place of the old one.  Raises RunFailed if the disk refuses; then the old one is still there.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    with _refusals(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with part.open("wb", buffering=0) as file:
                _put(file.fileno(), contents.encode() if isinstance(contents, str) else contents)
            os.replace(part, path)  # noqa: PTH105
        except BaseException:
            part.unlink(missing_ok=True)
            raise
        sync_folder(path.parent)


def append_line(path: Path, line: bytes) -> None:
    """Add a line to a file, on disk before this returns; a kill may leave a part of it at the end.

    Raises RunFailed if the disk refuses; then the file is as it was.
    """
    with _refusals(path), path.open("ab", buffering=0) as file:
        size = os.fstat(file.fileno()).st_size
        try:
            _put(file.fileno(), line + b"\n")
        except BaseException:
            with suppress(OSError):
                os.ftruncate(file.fileno(), size)
            raise


def take_lock(file: int) -> bool:
    """Lock an open file until it is closed or the process ends; False if another one has it.

    Where the system or the file system has no locks, nothing is held.
    """
    try:
        import fcntl  # not on every system

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except (ImportError, OSError):
        return True
    return True


def _put(file: int, contents: bytes) -> None:
    """Write all, through to the disk."""
    left = memoryview(contents)
    while left:
        left = left[os.write(file, left) :]
    os.fsync(file)


def sync_folder(folder: Path) -> None:
    """Make a new name in a folder last, where the system can."""
    with suppress(OSError):
        file = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(file)
        finally:
            os.close(file)


@contextmanager
def _refusals(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise RunFailed(
            f"cannot write {path}: {error.strerror}; mend that and run it again: what is finished"
            " is kept"
        ) from error
