"""What is drawn on, bars, pictures and tables: of ranks the terminals of what started them.

What ranks write to stdout and stderr comes by pipes; so the first of them opens the terminals
behind these by name, as long as it is on the same machine.
"""

import os
import sys
from contextlib import suppress
from functools import cache
from typing import Literal, TextIO

from swe_sphere.ranks.parallel import world

Stream = Literal["stdout", "stderr"]

HANDED: dict[Stream, str] = {"stdout": "SWE_SPHERE_STDOUT", "stderr": "SWE_SPHERE_STDERR"}
"""Environment variables that name the terminals behind them, each after its machine."""


def handed_on() -> dict[str, str]:
    """The environment in which ranks draw on the terminals of this process."""
    environment = dict(os.environ)
    for number in range(3):  # ranks cannot ask the terminal behind a pipe for its size
        with suppress(OSError):
            size = zip(("COLUMNS", "LINES"), os.get_terminal_size(number), strict=True)
            known = {name: str(length) for name, length in size if length > 0}  # some are 0 by 0
            environment = known | environment
    for number, name in enumerate(HANDED.values(), start=1):
        with suppress(OSError):
            environment[name] = f"{os.uname().nodename}:{os.ttyname(number)}"
    return environment


def screen(stream: Stream) -> TextIO:
    """The terminal behind stdout or stderr, where there is one; else the stream itself."""
    named = os.environ.get(HANDED[stream], "") if world().shared else ""
    return _opened(named) or getattr(sys, stream)


@cache
def _opened(named: str) -> TextIO | None:
    machine, _, terminal = named.partition(":")
    if machine != os.uname().nodename:
        return None
    with suppress(OSError):  # as of another user
        # a rank leads a session, which that terminal must not become the terminal of
        return os.fdopen(os.open(terminal, os.O_WRONLY | os.O_NOCTTY), "w", buffering=1)
    return None
