"""Code of the user: files with scenes, steppers, ... of their own, and calls whose errors tell."""

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
    """Whether a name given by the user is that of a Python file."""
    return str(name).endswith(".py")


def load_file(path: Path, what: str) -> ModuleType:
    """The module that the file makes, each time anew; `what` it should hold, for messages.

    Raises:
        ConfigError: there is no such file, or it fails; the line names the file and the line.
    """
    contents, place = file_contents(path, what), str(path.resolve())
    module = ModuleType(module_name(path))
    module.__file__ = place
    sys.modules[module.__name__] = module  # dataclasses and Warp look for it there
    _LOADED.add(place)
    code = guarded(str(path), compile, contents, place, "exec")
    guarded(str(path), exec, code, vars(module))
    return module


def file_contents(path: Path, what: str) -> bytes:
    """What is in the file; ConfigError where there is none, or none that can be read."""
    if not guarded(f"looking for {path}", path.is_file):
        raise ConfigError(f"there is no {what} file {path}")
    return guarded(str(path), path.read_bytes)


def module_name(path: Path) -> str:
    """Name of the module that the file makes, another one for each file."""
    return f"user_{path.stem}_{fingerprint([str(path.resolve())])[:8]}"


@contextmanager
def users_code() -> Iterator[None]:
    """What fails in the block, in a file that was loaded, is a ConfigError with file and line."""
    try:
        yield
    except (SweError, MemoryError):  # have lines of their own
        raise
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        theirs = [frame for frame in frames if frame.filename in _LOADED]
        if not theirs:
            raise
        file = Path(theirs[-1].filename).name
        message = f"{file} fails: {cause(error)} ({file}, line {theirs[-1].lineno})"
        raise ConfigError(message) from error


P = ParamSpec("P")
R = TypeVar("R")

OURS = f"{Path(__file__).parents[1]}{os.sep}"


def guarded(what: str, function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
    """What the function returns.

    Raises:
        ConfigError: the function raised something, or called `sys.exit`; the line begins with
            `what` and ends with the place in the user's file, where that is known.
    """
    try:
        return function(*args, **kwargs)
    except (SweError, MemoryError, KeyboardInterrupt):  # have lines of their own
        raise
    except BaseException as error:
        raise ConfigError(f"{what} fails: {cause(error)}{_place(error)}") from error


def cause(error: BaseException) -> str:
    """The error in words."""
    return f"{type(error).__name__}: {error}".removesuffix(": ")


def _place(error: BaseException) -> str:
    """The last line of the user's own file that was at work, in brackets."""
    frames = traceback.extract_tb(error.__traceback__)
    theirs = [f for f in frames if not f.filename.startswith((OURS, "<frozen "))]
    if not theirs:
        return ""
    last = [frame for frame in theirs if frame.filename == theirs[0].filename][-1]
    return f" ({Path(last.filename).name}, line {last.lineno})"
