"""Writing to disks that fill up: ask for the room first, and say what is wrong in one line.

HDF5 leaves a file in an unknown state when a write fails in the middle.  So the room for all it is
about to write is taken from the file system beforehand, behind the end of its data in the same
file; a full disk, a quota or a limit on file sizes shows there, before HDF5 has touched anything.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from swe_sphere.errors import ConfigError, SweError

__all__ = ["Room", "allocate", "clear_errors", "in_use"]

REFUSED = "the disk refused it (full, over quota, or gone)"
UNSUPPORTED = (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS)


class Room:
    """Room on disk for what is written to an open HDF5 file until the next `settle`."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file = os.open(path, os.O_RDWR)
        self._wanted = 0

    def reserve(self, size: int) -> None:
        """Take room for size more bytes; OSError if there is not as much."""
        self._wanted += size
        allocate(self._file, self._path, _hdf5_end(self._file), self._wanted)

    def settle(self) -> None:
        """The file has been flushed: what was reserved is used or not needed."""
        self._wanted = 0

    def trim(self) -> None:
        """After the HDF5 file was closed in order: give back what was not needed."""
        os.ftruncate(self._file, _hdf5_end(self._file))

    def close(self) -> None:
        """Forget the file."""
        os.close(self._file)


def allocate(file: int, path: Path, start: int, size: int) -> None:
    """Make sure that bytes start ... start + size of an open file can be written (OSError if not).

    Where the file system cannot allocate ahead, its free space is all there is to ask for.
    """
    try:
        os.posix_fallocate(file, start, size)
    except AttributeError:  # not on this system (macOS)
        _check_free(path, size)
    except OSError as error:
        if error.errno not in UNSUPPORTED:
            raise
        _check_free(path, size)


def _check_free(path: Path, size: int) -> None:
    if shutil.disk_usage(path.parent).free < size:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _hdf5_end(file: int) -> int:
    """End of the data of an HDF5 file as its superblock has it, the file's size in doubt.

    HDF5 File Format Specification 3.0, section II.A: byte 40 in versions 0 and 1, 28 in 2 and 3.
    """
    os.lseek(file, 0, os.SEEK_SET)
    head = os.read(file, 48)
    size = os.fstat(file).st_size
    if len(head) < 48 or head[:8] != b"\x89HDF\r\n\x1a\n" or head[8] > 3:
        return size
    offset = 40 if head[8] < 2 else 28
    end = int.from_bytes(head[offset : offset + 8], "little")
    return end if end < 2**63 else size


def in_use(file: int, *, for_writing: bool) -> bool:
    """Whether HDF5 has the file of a descriptor open elsewhere so that it cannot be read (written).

    HDF5 itself looks at the lock only after it has cut the file to nothing.
    """
    try:
        import fcntl  # not on every system

        fcntl.flock(file, (fcntl.LOCK_EX if for_writing else fcntl.LOCK_SH) | fcntl.LOCK_NB)
        fcntl.flock(file, fcntl.LOCK_UN)
    except BlockingIOError:
        return True
    except (ImportError, OSError):
        return False
    return False


@contextmanager
def clear_errors(what: str, kind: type[SweError] = ConfigError, after: str = "") -> Iterator[None]:
    """Turn what the operating system or HDF5 raises inside into one line: what, why, after."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        text = getattr(error, "strerror", None) or str(error)
        why = REFUSED if "HDF error" in text else text
        raise kind(f"{what}: {why}{after}") from error
