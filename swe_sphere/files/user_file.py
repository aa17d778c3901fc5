"""User-defined code: files with scenes, steppers, ..., and calls whose errors become one line."""

import os
import shlex
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, ParamSpec, TypeVar

from swe_sphere.errors import ConfigError, SweError
from swe_sphere.files.fingerprints import fingerprint

_LOADED: set[str] = set()


def is_user_file(name: str | Path) -> bool:
    """Return whether a name is that of a Python file."""
    return str(name).endswith(".py")


def check_trusted(name: object, path: Path, trusted: Iterable[Path], is_code: bool = False) -> None:
    """Raise ConfigError if the data in path name a Python or TOML file that the user did not name.

    A TOML file counts because its scene may use a Python file. is_code: any file counts.
    """
    is_code = is_code or str(name).endswith((".py", ".toml"))
    if is_code and Path(str(name)).absolute() not in {Path(each).absolute() for each in trusted}:
        raise ConfigError(
            f"{path} names the file {name}, whose code would be executed: read it, then allow it"
            f" with --trust {shlex.quote(str(name))} (in Python: trust=[...])"
        )


def is_custom(kind: Any) -> bool:
    """Return whether a class or a function is user-defined."""
    return not str(getattr(kind, "__module__", "")).startswith("swe_sphere.")


def load_file(path: Path, what: str) -> ModuleType:
    """Execute a file and return it as a module; what: its contents, for messages.

    Raises ConfigError if there is no such file or it fails; the message names file and line.
    """
    contents, place = file_contents(path, what), str(path.resolve())
    # files of the same name in different folders become different modules
    module = ModuleType(f"user_{path.stem}_{fingerprint([place])[:8]}")
    module.__file__ = place
    sys.modules[module.__name__] = module  # dataclasses and Warp search for it there
    _LOADED.add(place)
    code = call_custom(str(path), compile, contents, place, "exec")
    call_custom(str(path), exec, code, vars(module))
    return module


def file_of(function: Any) -> str | None:
    """Return the file that `load_file` executed and that defines a function; None if none does."""
    file = getattr(sys.modules.get(getattr(function, "__module__", "")), "__file__", None)
    return file if file in _LOADED else None


def file_contents(path: Path, what: str) -> bytes:
    """Return the contents of a file; ConfigError if it does not exist or cannot be read."""
    if not call_custom(f"looking for {path}", path.is_file):
        raise ConfigError(f"there is no {what} file {path}")
    return call_custom(str(path), path.read_bytes)


@contextmanager
def users_code(what: str = "") -> Iterator[None]:
    """Turn errors in the block into a ConfigError that ends with the line of the user's file.

    what: begins the message of code that is known to be user-defined, for all its errors, including
    a call of `sys.exit`; otherwise only errors in a loaded file are converted.
    """
    try:
        yield
    except (SweError, MemoryError, KeyboardInterrupt):  # these have their own messages
        raise
    except BaseException as error:
        frames = traceback.extract_tb(error.__traceback__)
        theirs = [frame for frame in frames if frame.filename in _LOADED]
        if not (what or theirs):
            raise
        ours = f"{Path(__file__).parents[1]}{os.sep}", "<frozen "
        others = [f for f in frames if not f.filename.startswith(ours)]
        last = theirs or [f for f in others if f.filename == others[0].filename]
        name, place = what, ""
        for frame in last[-1:]:
            file = Path(frame.filename).name
            name, place = what or file, f" ({file}, line {frame.lineno})"
        raise ConfigError(f"{name} fails: {cause(error)}{place}") from error


P = ParamSpec("P")
R = TypeVar("R")


def call_custom(what: str, function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
    """Return the result of a user-defined function; errors are converted as in `users_code`."""
    with users_code(what):
        return function(*args, **kwargs)


def cause(error: BaseException) -> str:
    """Return the type of an error and its message."""
    return f"{type(error).__name__}: {error}".removesuffix(": ")
