"""Files that a kill or a full disk at any moment leaves whole: the old one or the new one.

A new file is made beside the place where it is wanted, under a name of its own, and takes that
place by being renamed, which happens at once or not at all.
"""

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from swe_sphere.errors import ConfigError, RunFailed, SweError

MENDING = "; mend that and run it again: what is finished is kept"
UNSUPPORTED = (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS)


def write_whole(path: Path, contents: str | bytes) -> None:
    """Write a file, and its folder if need be, on disk before this returns; text in UTF-8.

    The contents go to a file beside it, of a name that no other process takes, which then takes the
    place of the old one.  Raises RunFailed if the disk refuses; then the old one is still there.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    with clear_errors(f"cannot write {path}", RunFailed, MENDING):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with part.open("wb", buffering=0) as file:
                _put(file.fileno(), contents.encode() if isinstance(contents, str) else contents)
            os.replace(part, path)  # noqa: PTH105
        except BaseException:
            part.unlink(missing_ok=True)
            raise
        _sync_folder(path.parent)


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


def _sync_folder(folder: Path) -> None:
    """Make a new name in a folder last, where the system can."""
    with suppress(OSError):
        sync(folder)


def sync(path: Path) -> None:
    """Write a file or a folder through to the disk; raises OSError where that fails."""
    file = os.open(path, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)


def refuse_to_replace(path: Path, overwrite: bool) -> None:
    """ConfigError if there is something at the path already and nobody said `overwrite`."""
    if path.exists() and not overwrite:
        raise ConfigError(f"{path} is there already: choose another name, or say --overwrite")


def part_of(path: Path) -> Path:
    """Where the file for a path is made."""
    return path.with_name(path.name + ".part")


def _old(path: Path) -> Path:
    """Where a folder is that another one takes the place of."""
    return path.with_name(path.name + ".old.part")


def check_moved(path: Path) -> None:
    """ConfigError where a program was killed amid `take_place`: both folders are whole."""
    if _old(path).exists() and not path.exists():
        raise ConfigError(
            f"{path} was being replaced when a program was killed: rename {part_of(path)} (the new"
            f" one) or {_old(path)} to {path}"
        )


def claim(path: Path, folder: bool = False) -> int:
    """The file at `part_of(path)`, new or left behind, locked for as long as it is open.

    The lock is that of the file and stays with it when it is renamed.  folder: the same for a
    folder, which is emptied.  Returns its descriptor.

    Raises:
        ConfigError: another program writes the file, or what is there is of another kind or was
            left by a program that was killed as it replaced it.
        OSError: it cannot be made.
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
    if not os.path.samestat(part.stat(), os.fstat(file)):
        os.close(file)
        raise ConfigError(_taken(path))
    for left in part.iterdir() if folder else ():
        remove(left)
    return file


def _locked(place: Path, flags: int, path: Path) -> int:
    """What is at the place, open; ConfigError if another program holds the lock."""
    file = os.open(place, flags, 0o666)
    if not take_lock(file):
        os.close(file)
        raise ConfigError(_taken(path))
    return file


def _taken(path: Path) -> str:
    return f"cannot write {path}: another program writes it"


def put_in_place(file: int, path: Path) -> None:
    """What was made at `part_of(path)`, open as `file`, is on the disk and then at the path."""
    os.fsync(file)
    take_place(path)


def take_place(path: Path) -> None:
    """What was made at `part_of(path)` is then at the path.

    A folder cannot take the place of another one at once: the old one has another name in between.
    """
    old = _old(path)
    if path.is_dir():
        remove(old)  # a killed program left it, and there is a newer one
        path.replace(old)
    part_of(path).replace(path)
    _sync_folder(path.parent)
    if path.is_dir():
        remove(old)


def remove(path: Path) -> None:
    """Remove a file or a folder with all that is in it, as far as it is there and can be."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def allocate(file: int, path: Path, size: int) -> None:
    """Make sure that an open file can become so many bytes long (OSError if not).

    Where the file system cannot allocate ahead, its free space is all there is to ask for.
    """
    try:
        os.posix_fallocate(file, 0, size)
    except AttributeError:  # not on this system (macOS)
        _check_free(path, size)
    except OSError as error:
        if error.errno not in UNSUPPORTED:
            raise
        _check_free(path, size)


def _check_free(path: Path, size: int) -> None:
    if shutil.disk_usage(path.parent).free < size:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@contextmanager
def clear_errors(what: str, kind: type[SweError] = ConfigError, after: str = "") -> Iterator[None]:
    """Turn what the operating system or netCDF raises inside into one line: what, why, after."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        text = getattr(error, "strerror", None) or str(error)
        raise kind(f"{what}: {text}{after}") from error
