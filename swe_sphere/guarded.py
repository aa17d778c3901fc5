"""Calling what a user wrote: whatever goes wrong in there is one clear line."""

import os
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec, TypeVar

from swe_sphere.errors import ConfigError, SweError

P = ParamSpec("P")
R = TypeVar("R")

OURS = f"{Path(__file__).parent}{os.sep}"


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
