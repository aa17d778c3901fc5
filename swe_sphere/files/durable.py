"""Durable files: a kill or a full disk leaves either the old or the new file, complete.

A new file is built beside its path, under an unpredictable name, and renamed at once or not at all.
"""

import errno
import fcntl
import hashlib
import os
import secrets
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path

from swe_sphere.errors import ConfigError, RunFailed, SweError

MENDING = "; correct this and run the command again: finished work is kept"
PART, OLD = ".part", ".old"
"""What precedes the suffix in names of unfinished files and folders, and of replaced folders."""
SHOWN = 40
"""Number of characters of a path's name in its temporary names."""
OF_THE_DISK = {errno.ENOSPC, errno.EDQUOT, errno.EIO}
"""Errors that are no fault of the request."""
PATIENCE = 0.2
"""Time for which a program waits for others that claim the same file [s]."""


def write_whole(path: Path, contents: str | bytes) -> None:
    """Write a file, text in UTF-8, and its folder if necessary; both are then on the disk.

    Raises RunFailed if the disk fails; the old file is then still in place.
    """
    with translate_errors(f"cannot write {path}", RunFailed, MENDING):
        path.parent.mkdir(parents=True, exist_ok=True)
        with suppress(ConfigError):  # another program may write this file, too
            _remove_unfinished(path)
        file, part = _create(path)
        try:
            part.write_bytes(contents.encode() if isinstance(contents, str) else contents)
            take_place(part, path)
        finally:
            release(file)
            part.unlink(missing_ok=True)


def contents_of(path: Path) -> bytes:
    """Return the contents of a file; OSError if there is none, or a pipe, which would block."""
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "it is not a file", str(path))
    return path.read_bytes()


def sync(path: Path) -> None:
    """Write a file or a folder through to the disk; raises OSError if that fails."""
    file = os.open(path, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)


def take_lock(file: int) -> bool:
    """Lock an open file until it is closed or the process ends; False if another one holds it.

    On a file system without locks the function does nothing.
    """
    with suppress(OSError):
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
    return True


def release(file: int) -> None:
    """Unlock and close a file, also if a process that was forked still has it open."""
    with suppress(OSError):
        fcntl.flock(file, fcntl.LOCK_UN)
    os.close(file)


def _mark(path: Path, number: str) -> str:
    """Return the mark of this program in the temporary name for a path with a random number."""
    return hashlib.sha256(f"swe_sphere {path.name} {number}".encode()).hexdigest()[:8]


def _new_name(path: Path, ending: str = PART) -> Path:
    """Return an unpredictable name beside a path, with the mark of this program."""
    token = (number := secrets.token_hex(4)) + _mark(path, number)
    return path.with_name(f".{path.name[:SHOWN]}.{token}{ending}{path.suffix}")


def _marked(path: Path, ending: str = PART) -> list[Path]:
    """Return the files and folders with temporary names for a path that this program created."""
    ending += path.suffix
    beside = path.parent.glob(f".{escape(path.name[:SHOWN])}.*{ending}")
    numbers = {each: each.name.removesuffix(ending).rpartition(".")[2] for each in beside}
    ours = [each for each, text in numbers.items() if _mark(path, text[:8]) == text[8:]]
    return [each for each in ours if not each.is_symlink() and (each.is_dir() or each.is_file())]


def check_moved(path: Path) -> None:
    """Raise ConfigError if a program was killed during `take_place`: both folders are complete."""
    if not path.exists():
        for old in _marked(path, OLD):
            parts = [[*part.glob(escape(path.name)), part][0] for part in _marked(path)]
            new = " or ".join([f"{part} (the new one)" for part in parts] + [str(old)])
            raise ConfigError(
                f"{path} was being replaced when a program was killed: rename {new} to {path}"
            )


def claim(path: Path, folder: bool = False) -> tuple[int, Path]:
    """Create a file or folder with a temporary name, to be built there for a path.

    It is locked while its descriptor is open, also after it is renamed. Temporary files of a killed
    program are removed. Returns the descriptor and the name.

    Raises ConfigError if another program writes the path, it is of another kind, or a program was
    killed while it replaced it; OSError if the file or folder cannot be created.
    """
    check_moved(path)
    if path.exists() and not (path.is_dir() if folder else path.is_file()):
        raise ConfigError(f"cannot write {path}: it is not a {'folder' if folder else 'file'}")
    file, part = _create(path, folder)
    wait = PATIENCE
    while True:  # if programs create files at the same time, the first in order of names stays
        try:
            _remove_unfinished(path, part)
            if path.exists():  # checked last: temporary files are renamed to it
                release(_locked(path, os.O_RDONLY, path))
            return file, part
        except (ConfigError, OSError):
            if not wait or min(_marked(path), default=None) != part:
                release(file)
                remove(part)
                raise
        time.sleep(wait)
        wait = 0.0


def _remove_unfinished(path: Path, own: Path | None = None) -> None:
    """Remove temporary files of killed programs; ConfigError if another program writes the path."""
    for passed_over in (ConfigError, FileNotFoundError):  # the second round may raise ConfigError
        for left in [each for each in _marked(path) if each != own]:
            with suppress(FileNotFoundError, passed_over):
                file = _locked(left, os.O_RDONLY | os.O_NOFOLLOW, path)
                try:
                    remove(left)  # before its creator, who has not locked it yet, can do so
                finally:
                    release(file)


def _create(path: Path, folder: bool = False, tries: int = 5) -> tuple[int, Path]:
    """Create and lock a temporary file or folder; return its descriptor and its name."""
    part = _new_name(path)
    if folder:
        part.mkdir()
    kind = os.O_RDONLY | os.O_DIRECTORY if folder else os.O_RDWR | os.O_CREAT | os.O_EXCL
    try:
        return _locked(part, kind | os.O_NOFOLLOW, path), part
    except (ConfigError, FileNotFoundError):  # removed by another program before it was locked
        if tries and path.parent.exists():
            return _create(path, folder, tries - 1)
        raise


@contextmanager
def building(path: Path) -> Iterator[Path]:
    """Yield a name in a temporary folder; what the block builds there is renamed at the end."""
    name, path = path.name, path.resolve() if path.is_symlink() else path
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise ConfigError(f"cannot write {path}: it is not a file")
    _remove_unfinished(path)
    file, place = _create(path, folder=True)  # libraries lock the file itself, or replace it
    try:
        if path.exists():
            release(_locked(path, os.O_RDONLY, path))
        yield (part := place / name)
        take_place(part, path)
    finally:
        release(file)
        remove(place)


def _locked(place: Path, flags: int, path: Path) -> int:
    """Open a file and lock it; ConfigError if another program has locked or renamed it."""
    file = os.open(place, flags, 0o666)
    with suppress(FileNotFoundError):  # removed before it was locked
        if take_lock(file) and os.path.samestat(place.stat(), os.fstat(file)):
            return file
    os.close(file)
    raise ConfigError(f"cannot write {path}: another program writes it")


def take_place(part: Path, path: Path) -> None:
    """Sync a file with a temporary name (of a folder, its list alone), and move it to the path.

    A folder cannot replace another one at once: the old one has another name in between.
    """
    sync(part)
    is_folder = part.is_dir()
    if is_folder and path.is_dir():
        path.replace(_new_name(path, OLD))
    part.replace(path)
    with suppress(OSError):  # some systems cannot sync a folder
        sync(path.parent)
    for old in _marked(path, OLD) if is_folder else ():  # also a remainder of a killed program
        remove(old)


def remove(path: Path) -> None:
    """Remove a file (OSError if that fails), or what can be removed of a folder, if it exists."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def allocate(file: int, path: Path, size: int) -> None:
    """Make sure that an open file can grow to `size` bytes; raises OSError otherwise.

    If the file system cannot allocate ahead, its free space must suffice.
    """
    try:
        os.posix_fallocate(file, 0, size)
    except OSError as error:
        if error.errno not in (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS):
            raise
        if shutil.disk_usage(path.parent).free < size:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)) from None


@contextmanager
def translate_errors(
    what: str, kind: type[SweError] = ConfigError, after: str = ""
) -> Iterator[None]:
    """Convert errors of the system or netCDF in the block to a `kind`: "what: reason" + after.

    A disk that is full or fails raises RunFailed in any case, if the error has its number.
    """
    try:
        yield
    except (OSError, RuntimeError) as error:
        text = getattr(error, "strerror", None) or str(error)
        kind = RunFailed if getattr(error, "errno", None) in OF_THE_DISK else kind
        raise kind(f"{what}: {text}{after}") from error
