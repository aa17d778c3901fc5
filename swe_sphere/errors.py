"""Errors that a user can correct: each is printed as one line without traceback."""

import difflib
import reprlib
from collections.abc import Iterable
from typing import NoReturn


class SweError(Exception):
    """An error whose message is one clear line that states what to change."""

    exit_status = 1
    status = "failed"
    """Status of a run that ended with this error, in one word."""


class ConfigError(SweError):
    """The request cannot be carried out as written (unknown name, number out of range, ...)."""

    exit_status = 2
    status = "refused"


class RunFailed(SweError):
    """A run had to stop early (NaN, negative depth, a step that cannot be solved, a full disk)."""


class Unstable(RunFailed):
    """The solution became unstable (NaN, negative depth, runaway energy)."""

    status = "unstable"


class SolverFailed(RunFailed):
    """The equations of a step cannot be solved."""

    status = "solver-failed"


class TimedOut(RunFailed):
    """The time limit of the run has passed; its state is sound."""

    status = "timed-out"


class Interrupted(Exception):
    """The user asked the program to stop; the message names the signal."""

    exit_status = 130  # as in shells
    status = "interrupted"


class NotCopyable:
    """Base of objects with memory on a device, which cannot be copied or pickled."""

    def __reduce_ex__(self, protocol: object) -> NoReturn:
        raise ConfigError(
            f"a {type(self).__name__} cannot be copied or pickled: write sim.checkpoint(path), and"
            " begin others with Simulation.from_checkpoint(path)"
        )


def in_one_line(text: object) -> str:
    """Return the text without line breaks."""
    return " ".join(str(text).split())


def shown(value: object) -> str:
    """Return the value in Python's notation, shortened if it is long, for messages."""
    short = reprlib.Repr()
    short.maxstring = short.maxother = short.maxlong = 60
    try:
        return short.repr(value)
    except ValueError:  # Python refuses to convert such large integers to text
        return "a number of thousands of digits"


def unknown_name(kind: str, name: str, known: Iterable[str]) -> ConfigError:
    """Return the error for a name that is not among the known ones: the nearest name, then all."""
    names = list(known)
    near = difflib.get_close_matches(str(name).lower(), names, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]!r}? There" if near else "there"
    return ConfigError(f"unknown {kind} {shown(name)}; {hint} are: {', '.join(names)}")
