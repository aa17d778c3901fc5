"""What can go wrong in a way the user can mend: one line each, no traceback."""

import difflib
import reprlib
from collections.abc import Iterable


class SweError(Exception):
    """An error whose message is one clear line saying what to change."""

    exit_status = 1


class ConfigError(SweError):
    """The request cannot be carried out as written (unknown name, number out of range, ...)."""

    exit_status = 2


class RunFailed(SweError):
    """A run had to stop early (not a number, negative depth, a step that cannot be solved, ...)."""

    exit_status = 1


class Unstable(RunFailed):
    """The solution makes no sense any more (not a number, negative depth, runaway energy)."""


class TimedOut(RunFailed):
    """The time that the user gave the run is used up; its state is sound."""


class _Short(reprlib.Repr):
    """Of long values the beginning and the end."""

    def __init__(self) -> None:
        super().__init__()
        self.maxstring = self.maxother = self.maxlong = 60

    def repr_int(self, x: int, level: int) -> str:
        """Also of whole numbers that Python itself refuses to write out."""
        try:
            return super().repr_int(x, level)
        except ValueError:
            return "a number of thousands of digits"


def shown(value: object) -> str:
    """The value as an error message shows it: in Python's notation, shortened where it is long."""
    return _Short().repr(value)


def unknown_name(kind: str, name: str, known: Iterable[str]) -> ConfigError:
    """The error for a name that is not among the known ones: the nearest of them, then all."""
    names = list(known)
    near = difflib.get_close_matches(name.lower(), names, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]!r}? " if near else ""
    return ConfigError(f"unknown {kind} {shown(name)}; {hint}There are: {', '.join(names)}")
