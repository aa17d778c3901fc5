"""User-defined code: files with scenes, steppers, ..., and calls whose errors become one line."""

import os
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import ParamSpec, TypeVar

from swe_sphere.errors import ConfigError, SweError
from swe_sphere.files.fingerprints import fingerprint

_LOADED: set[str] = set()


def is_user_file(name: str | Path) -> bool:
    """Return whether a name is that of a Python file."""
    return str(name).endswith(".py")


def load_file(path: Path, what: str) -> ModuleType:
    """Execute a file and return it as a module; what: its contents, for messages.

    Raises ConfigError where there is no such file or it fails; the message names file and line.
    """
    contents, place = file_contents(path, what), str(path.resolve())
    # each file has another name
    module = ModuleType(f"user_{path.stem}_{fingerprint([place])[:8]}")
    module.__file__ = place
    sys.modules[module.__name__] = module  # dataclasses and Warp look for it there
    _LOADED.add(place)
    code = guarded(str(path), compile, contents, place, "exec")
    guarded(str(path), exec, code, vars(module))
    return module


def file_contents(path: Path, what: str) -> bytes:
    """Return the contents of a file; ConfigError where it does not exist or cannot be read."""
    if not guarded(f"looking for {path}", path.is_file):
        raise ConfigError(f"there is no {what} file {path}")
    return guarded(str(path), path.read_bytes)


@contextmanager
def users_code() -> Iterator[None]:
    """Turn what fails in the block, in a file that was loaded, into a ConfigError with its line."""
    try:
        yield
    except (SweError, MemoryError):  # have lines of their own
        raise
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        theirs = [frame for frame in frames if frame.filename in _LOADED]
        if not theirs:
            raise
        name = Path(theirs[-1].filename).name
        raise ConfigError(f"{name} fails: {cause(error)}{_line(theirs[-1])}") from error


P = ParamSpec("P")
R = TypeVar("R")

OURS = f"{Path(__file__).parents[1]}{os.sep}"


def guarded(what: str, function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
    """Return the result of a user-defined function.

    Raises:
        ConfigError: the function raised something, or called `sys.exit`; the line begins with
            `what` and ends with the place in the user's file, where that is known.
    """
    try:
        return function(*args, **kwargs)
    except (SweError, MemoryError, KeyboardInterrupt):  # have lines of their own
        raise
    except BaseException as error:
        frames = traceback.extract_tb(error.__traceback__)
        theirs = [f for f in frames if not f.filename.startswith((OURS, "<frozen "))]
        last = [frame for frame in theirs if frame.filename == theirs[0].filename][-1:]
        place = "".join(map(_line, last))
        raise ConfigError(f"{what} fails: {cause(error)}{place}") from error


def cause(error: BaseException) -> str:
    """Return the kind of an error and its message."""
    return f"{type(error).__name__}: {error}".removesuffix(": ")


def _line(frame: traceback.FrameSummary) -> str:
    return f" ({Path(frame.filename).name}, line {frame.lineno})"
