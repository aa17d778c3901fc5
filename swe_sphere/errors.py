"""What can go wrong in a way the user can mend: one line each, no traceback."""


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
