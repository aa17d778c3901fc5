"""Files that a kill or a full disk leaves whole, the old one or the new one.

A new file is built beside its place, under another name, and takes its place by being renamed,
which happens at once or not at all.
"""

import errno
import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from swe_sphere.errors import ConfigError, RunFailed, SweError

MENDING = "; mend that and run it again: what is finished is kept"
UNSUPPORTED = (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS)


def write_whole(path: Path, contents: str | bytes) -> None:
    """Write a file, text in UTF-8, and its folder if need be; both are on the disk afterwards.

    Raises RunFailed if the disk refuses; the old file is then still in its place.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    with clear_errors(f"cannot write {path}", RunFailed, MENDING):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            part.write_bytes(contents.encode() if isinstance(contents, str) else contents)
            sync(part)
            _rename(part, path)
        except BaseException:
            part.unlink(missing_ok=True)
            raise


def _rename(part: Path, path: Path) -> None:
    part.replace(path)
    with suppress(OSError):  # some systems cannot sync a folder
        sync(path.parent)


def sync(path: Path) -> None:
    """Write a file or a folder through to the disk; raises OSError where that fails."""
    file = os.open(path, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)


def take_lock(file: int) -> bool:
    """Lock an open file until it is closed or the process ends; False if another one has it.

    Where the file system has no locks, nothing is held.
    """
    with suppress(OSError):
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
    return True


def part_of(path: Path) -> Path:
    """Return the path at which the file or folder for a path is built."""
    return path.with_name(path.name + ".part")


def _old(path: Path) -> Path:
    """Return the path of a folder that is being replaced."""
    return path.with_name(path.name + ".old.part")


def check_moved(path: Path) -> None:
    """Raise ConfigError where a program was killed amid `take_place`: both folders are whole."""
    if _old(path).exists() and not path.exists():
        raise ConfigError(
            f"{path} was being replaced when a program was killed: rename {part_of(path)} (the new"
            f" one) or {_old(path)} to {path}"
        )


def claim(path: Path, folder: bool = False) -> int:
    """Open the file at `part_of(path)`, new or left behind, and lock it for as long as it is open.

    The lock is that of the file and stays with it when it is renamed.  folder: the same for a
    folder, which is emptied.  Returns the descriptor.

    Raises:
        ConfigError: another program writes the file, or what exists is of another kind or was left
            by a program that was killed as it replaced it.
        OSError: it cannot be opened.
    """
    check_moved(path)
    if path.exists():
        if not (path.is_dir() if folder else path.is_file()):
            what = "folder" if folder else "file"
            raise ConfigError(f"cannot write {path}: what is there is no {what}")
        os.close(_locked(path, os.O_RDONLY, path))
    part = part_of(path)
    if folder:
        part.mkdir(exist_ok=True)
    file = _locked(part, os.O_RDONLY if folder else os.O_RDWR | os.O_CREAT, path)
    for left in part.iterdir() if folder else ():
        remove(left)
    return file


def _locked(place: Path, flags: int, path: Path) -> int:
    """Open a file and lock it; ConfigError if another program has locked or renamed it."""
    file = os.open(place, flags, 0o666)
    if not (take_lock(file) and os.path.samestat(place.stat(), os.fstat(file))):
        os.close(file)
        raise ConfigError(f"cannot write {path}: another program writes it")
    return file


def take_place(path: Path) -> None:
    """Write what was built at `part_of(path)` through to the disk, and move it to the path.

    A folder cannot take the place of another one at once: the old one has another name in between.
    """
    sync(part_of(path))
    if path.is_dir():
        remove(_old(path))  # a killed program left it, and there is a newer one
        path.replace(_old(path))
    _rename(part_of(path), path)
    if path.is_dir():
        remove(_old(path))


def remove(path: Path) -> None:
    """Remove a file or a folder with its contents, as far as it exists and can be removed."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def allocate(file: int, path: Path, size: int) -> None:
    """Make sure that an open file can become so many bytes long (OSError if not).

    Where the file system cannot allocate ahead, its free space must suffice.
    """
    try:
        os.posix_fallocate(file, 0, size)
    except OSError as error:
        if error.errno not in UNSUPPORTED:
            raise
        if shutil.disk_usage(path.parent).free < size:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)) from None


@contextmanager
def clear_errors(what: str, kind: type[SweError] = ConfigError, after: str = "") -> Iterator[None]:
    """Turn what the operating system or netCDF raises inside into one line: what, why, after."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        text = getattr(error, "strerror", None) or str(error)
        raise kind(f"{what}: {text}{after}") from error
