"""Terminals for bars, pictures and tables: ranks draw on the terminals of their launcher.

Pipes carry stdout and stderr of ranks.  Rank 0 therefore opens the terminals behind the pipes by
name, if it runs on the same machine.
"""

import os
import sys
from contextlib import suppress
from functools import cache
from typing import Literal, TextIO

from swe_sphere.ranks.communicator import world

Stream = Literal["stdout", "stderr"]

HANDED: dict[Stream, str] = {"stdout": "SWE_SPHERE_STDOUT", "stderr": "SWE_SPHERE_STDERR"}
"""Environment variables with the terminal behind each stream, as MACHINE:NAME."""


def handed_on() -> dict[str, str]:
    """Return an environment in which ranks draw on the terminals of this process."""
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
    """Return the terminal behind a stream, where there is one, or else the stream itself."""
    named = os.environ.get(HANDED[stream], "") if world().shared else ""
    return _opened(named) or getattr(sys, stream)


@cache
def _opened(named: str) -> TextIO | None:
    machine, _, terminal = named.partition(":")
    if machine != os.uname().nodename:
        return None
    with suppress(OSError):  # it may belong to another user
        # a rank leads a session, whose terminal this one must not become
        return os.fdopen(os.open(terminal, os.O_WRONLY | os.O_NOCTTY), "w", buffering=1)
    return None
