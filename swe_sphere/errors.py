"""Errors that a user can correct: each is printed as one line without traceback."""

import difflib
import reprlib
from collections.abc import Iterable


class SweError(Exception):
    """An error whose message is one clear line saying what to change."""

    exit_status = 1
    status = "failed"
    """How a run that it ended is said to have ended, in one word."""


class ConfigError(SweError):
    """The request cannot be carried out as written (unknown name, number out of range, ...)."""

    exit_status = 2
    status = "refused"


class RunFailed(SweError):
    """A run had to stop early (NaN, negative depth, a step that cannot be solved, a full disk)."""


class Unstable(RunFailed):
    """The solution makes no sense any more (NaN, negative depth, runaway energy)."""

    status = "unstable"


class SolverFailed(RunFailed):
    """The equations of a step cannot be solved, in its smallest part or at all."""

    status = "solver-failed"


class TimedOut(RunFailed):
    """The time that the user gave the run is used up; its state is sound."""

    status = "timed-out"


def in_one_line(text: object) -> str:
    """The text without line breaks."""
    return " ".join(str(text).split())


def shown(value: object) -> str:
    """The value as an error message shows it: in Python's notation, shortened where it is long."""
    short = reprlib.Repr()
    short.maxstring = short.maxother = short.maxlong = 60
    try:
        return short.repr(value)
    except ValueError:  # Python refuses to write such whole numbers out
        return "a number of thousands of digits"


def unknown_name(kind: str, name: str, known: Iterable[str]) -> ConfigError:
    """The error for a name that is not among the known ones: the nearest of them, then all."""
    names = list(known)
    near = difflib.get_close_matches(name.lower(), names, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]!r}? " if near else ""
    return ConfigError(f"unknown {kind} {shown(name)}; {hint}There are: {', '.join(names)}")
