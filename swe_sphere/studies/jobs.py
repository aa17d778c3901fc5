"""Runs of a study in several processes, for results that do not include times."""

import os
import signal
import sys
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from functools import cache
from multiprocessing import active_children, get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from threading import RLock, Thread
from types import ModuleType
from typing import Any

from tqdm import tqdm

from swe_sphere.errors import ConfigError, RunFailed, SweError
from swe_sphere.ranks.communicator import leave_ranks
from swe_sphere.simulation.loop import Interruption

MOST_JOBS = 1024
IGNORED = {signal.SIGINT, signal.SIGHUP}
"""Signals to which only the process that started the others reacts: it then ends them."""
POLLING = 0.2
"""Seconds between two checks for results and for an interruption."""


def checked_jobs(jobs: int) -> int:
    """Return the number of processes; ConfigError unless it is between 1 and `MOST_JOBS`."""
    if not 1 <= jobs <= MOST_JOBS:
        raise ConfigError(f"jobs={jobs}: give a number of processes, 1 to {MOST_JOBS}")
    return jobs


def in_processes(
    jobs: int, begin: Callable[[], Callable[[Any], Any]], tasks: Sequence[object]
) -> Iterator[Any]:
    """Yield the results of tasks from up to `jobs` processes, in the order of their arrival.

    The processes end when the iterator is exhausted or closed. begin: picklable, called once in
    each process. It returns a function that does one task and returns its result, which must be
    small: a process that dies in the middle of a message leaves its reader waiting.

    Raises Interrupted if the user asked to stop, RunFailed if a process died or a task raised an
    unexpected exception, and any SweError that a task raised.
    """
    if not tasks:
        return
    spawn = get_context("spawn")
    alive, ours = spawn.Pipe(duplex=False)
    processes, others = set[BaseProcess](), {*active_children()}
    pool = ProcessPoolExecutor(min(jobs, len(tasks)), spawn, _initialise, (alive, begin))
    try:
        with Interruption() as interruption, ExitStack() as stack:
            stack.callback(pool.shutdown, cancel_futures=True)
            stack.callback(ours.close)  # ends the processes, before the pool waits for them
            with _private_start():
                pending = {pool.submit(_do, task) for task in tasks}
            processes |= {*active_children()} - others
            while pending:
                done, pending = wait(pending, POLLING, FIRST_COMPLETED)
                interruption.check()
                for future in sorted(done, key=lambda each: each.exception() is not None):
                    yield future.result()
                # the pool does not watch a process that it started while it waited for others
                if any(each.exitcode for each in processes):
                    raise BrokenProcessPool
    except BrokenProcessPool:
        raise RunFailed(
            f"jobs: one of the processes {_end_of(processes)}: take fewer if memory ran out;"
            " finished runs stay where `out` keeps them"
        ) from None


def _end_of(processes: Collection[BaseProcess]) -> str:
    """Return how a process died, in words; the pool kills or terminates the others after it."""
    codes = {each.exitcode or 0 for each in processes} - {0, -signal.SIGTERM}
    code = min(codes - {-signal.SIGKILL} or codes, default=0)
    if code < 0:
        return f"was killed by {signal.Signals(-code).name}"
    return f"ended with {code}" if code else "died"


@contextmanager
def _private_start() -> Iterator[None]:
    """Start processes in the block that ignore Ctrl-C and do not run the user's script again."""
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    before = signal.pthread_sigmask(signal.SIG_BLOCK, IGNORED)
    try:
        yield
    finally:
        sys.modules["__main__"] = main
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


_work: Callable[[], Callable[[Any], Any]]
"""Function of this process of the pool that returns the function that does a task."""


def _initialise(alive: Connection, begin: Callable[[], Callable[[Any], Any]]) -> None:
    """Prepare a process of the pool; `begin` waits for the first task, which reports its errors."""
    leave_ranks()
    tqdm.set_lock(RLock())  # its default is a semaphore, which a killed process leaves behind
    Thread(target=_end_with_parent, args=(alive,), daemon=True).start()
    global _work
    _work = cache(begin)


def _do(task: object) -> Any:
    try:
        return _work()(task)
    except SweError:
        raise
    except Exception as error:
        raise RunFailed(f"unexpected {type(error).__name__}: {error}") from None


def _end_with_parent(alive: Connection) -> None:
    """End this process when the other end of the pipe is closed or its process died."""
    alive.poll(None)
    os.kill(os.getpid(), signal.SIGKILL)
