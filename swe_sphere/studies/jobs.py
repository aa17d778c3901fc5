"""Runs of a study in processes beside each other, where their results are wanted, not their times.

What the processes find is kept by the one that started them, record by record; it then goes through
the study as ever, and finds there what it would have made.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import get_context, parent_process, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from threading import Thread
from types import ModuleType
from typing import Any, TypeVar

from swe_sphere.errors import ConfigError, RunFailed, SweError
from swe_sphere.ranks.parallel import leave_ranks
from swe_sphere.simulation.interrupt import Interruption

T = TypeVar("T")
Tell = Callable[[Any], None]
"""Passes on what was found."""
Begin = Callable[..., Callable[[Any], None]]
"""Gets ready in a process of its own, told how to pass on results: what does a task there."""

MOST_JOBS = 1024
LOOK = 0.2
"""Seconds between two looks whether the user wants to stop."""


def checked_jobs(jobs: int) -> int:
    """The number of processes; ConfigError for one that makes no sense."""
    if not 1 <= jobs <= MOST_JOBS:
        raise ConfigError(f"jobs={jobs}: give a number of processes, 1 to {MOST_JOBS}")
    return jobs


@dataclass
class _Helper:
    """A process that does one task after the other."""

    process: SpawnProcess
    pipe: Connection
    busy: bool = False

    def ask(self, task: object) -> None:
        with suppress(OSError):  # it has died, which shows when it is listened to
            self.pipe.send(task)
        self.busy = True


def in_processes(
    jobs: int, begin: Begin, arguments: Sequence[object], tasks: Sequence[object]
) -> Iterator[Any]:
    """What is found in up to that many processes, as it comes; they end when this is left.

    begin: a function of a module, called as begin(tell, *arguments) in each process; what it
    returns does a task and tells what it finds.

    Raises:
        Interrupted: the user asked to stop.
        RunFailed: a process has died.
        SweError: what a task raised.
    """
    left = list(reversed(tasks))
    helpers: list[_Helper] = []
    try:
        with Interruption() as interruption:
            for _ in range(min(jobs, len(left))):
                helpers.append(_started(begin, arguments))
                helpers[-1].ask(left.pop())
            while busy := [helper for helper in helpers if helper.busy]:
                ready = wait([helper.pipe for helper in busy], LOOK)
                interruption.check()
                for helper in (each for each in busy if each.pipe in ready):
                    found = _heard(helper)
                    if found is not None:
                        yield found
                    elif left:
                        helper.ask(left.pop())
                    else:
                        helper.busy = False
    finally:
        for helper in helpers:
            helper.process.kill()
            helper.process.join()


def _heard(helper: _Helper) -> Any:
    """What it has found; None: its task is done."""
    try:
        found = helper.pipe.recv()
    except (EOFError, OSError):
        helper.process.join()
        code = helper.process.exitcode or 0
        how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with {code}"
        raise RunFailed(
            f"jobs: one of the processes {how}: take fewer if memory ran out; finished runs stay"
            " where `out` keeps them"
        ) from None
    if isinstance(found, Exception):
        raise found
    return found


def _started(begin: Begin, arguments: Sequence[object]) -> _Helper:
    ours, theirs = get_context("spawn").Pipe()
    process = get_context("spawn").Process(target=_serve, args=(theirs, begin, arguments))
    with _deaf_to_the_terminal(), _no_script():
        process.start()
    theirs.close()
    return _Helper(process, ours)


@contextmanager
def _deaf_to_the_terminal() -> Iterator[None]:
    """Processes started in the block do not hear Ctrl-C: the one that started them ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # starting it would let them hear again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT, signal.SIGHUP])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _no_script() -> Iterator[None]:
    """Processes started in the block do not run the user's script, of which they need nothing."""
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


def _serve(pipe: Connection, begin: Begin, arguments: Sequence[object]) -> None:
    """Do tasks as long as there are any and somebody who asks."""
    leave_ranks()
    Thread(target=_end_with_parent, daemon=True).start()
    failure: SweError
    try:
        work = begin(pipe.send, *arguments)
        while True:
            work(pipe.recv())
            pipe.send(None)
    except (EOFError, ConnectionError):  # nobody asks or listens any more
        return
    except SweError as error:
        failure = error
    except Exception as error:
        failure = RunFailed(f"unexpected {type(error).__name__}: {error}")
    with suppress(OSError):
        pipe.send(failure)


def _end_with_parent() -> None:
    """However the parent ends: it may be killed in the middle of a run."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), getattr(signal, "SIGKILL", signal.SIGTERM))
