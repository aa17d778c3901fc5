"""One clear line for whatever goes wrong."""

import os
import traceback

import typer

from swe_sphere.errors import SweError, in_one_line

DEBUG = "SWE_SPHERE_DEBUG"
"""Environment variable that asks for the traceback of an error."""


class Stopped(SweError):
    """The user stopped the program before a run had begun."""

    exit_status = 130


def explain(error: Exception) -> tuple[str, int]:
    """What to tell the user, in one line, and the exit status."""
    line, status = _explain(error)
    return in_one_line(line), status


def show_traceback() -> None:
    """Print where the error being handled came from, if the user asked for that."""
    if os.environ.get(DEBUG):
        traceback.print_exc()


def _explain(error: Exception) -> tuple[str, int]:
    if isinstance(error, SweError):
        return str(error), error.exit_status
    if isinstance(error, typer.TyperException):
        return f"{error.format_message()} (see swe-sphere --help)", error.exit_code
    hint = f"({DEBUG}=1 shows where)"
    if isinstance(error, MemoryError):
        return f"not enough memory: take a smaller mesh {hint}", 1
    return f"unexpected {type(error).__name__}: {error} {hint}", 1
