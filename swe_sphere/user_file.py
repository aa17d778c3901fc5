"""Python files of the user: a scene, a stepper or a preconditioner of their own."""

import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

from swe_sphere.errors import ConfigError, SweError
from swe_sphere.fingerprints import fingerprint
from swe_sphere.guarded import cause, guarded

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
