"""Limits of a process: memory that it may still occupy, threads of BLAS, and time."""

import os
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from contextvars import ContextVar
from functools import cache
from pathlib import Path

from threadpoolctl import ThreadpoolController

from swe_sphere.errors import SweError


class StopRequest(SweError):
    """Raised to interrupt a step, because the user asked to stop or the time is used up."""


stop_is_asked: ContextVar[Callable[[], bool]] = ContextVar("asked", default=lambda: False)
"""Function () of the loop over time steps that returns whether the loop is to stop."""
command_began: ContextVar[float] = ContextVar("began")
"""Start of the present command [s, of time.monotonic], from which its time limit counts."""


def check_stop() -> None:
    """Raise StopRequest if the loop that takes the present step is to stop.

    Long steps call this function repeatedly, on all ranks at the same point of their work.
    """
    if stop_is_asked.get()():
        raise StopRequest("the step was interrupted")


def process_age() -> float:
    """Return the wall time since this process was started [s]; 0 if it is unknown."""
    with suppress(OSError, ValueError, IndexError, AttributeError):
        started = Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19]
        now = time.clock_gettime(time.CLOCK_BOOTTIME)
        return max(0.0, now - int(started) / os.sysconf("SC_CLK_TCK"))
    return 0.0


@cache
def _libraries(scipy_is_loaded: bool) -> ThreadpoolController:
    """Return the loaded BLAS libraries, cached apart once `scipy.linalg` has added a library."""
    return ThreadpoolController()


def one_thread() -> AbstractContextManager[object]:
    """Limit BLAS to one thread within a block.

    The BLAS threads of numpy and of scipy both spin while idle, and slow each other down.
    """
    libraries = _libraries("scipy.linalg" in sys.modules)
    limited: AbstractContextManager[object] = libraries.limit(limits=1, user_api="blas")
    return limited


def keep_to_one_thread() -> None:
    """Limit BLAS to one thread in this process, unless OPENBLAS_NUM_THREADS sets another count.

    The limit also holds for libraries loaded later. Processes that share a machine need the limit,
    because their spinning threads would wait for each other.
    """
    if os.environ.setdefault("OPENBLAS_NUM_THREADS", "1") == "1":
        ThreadpoolController().limit(limits=1, user_api="blas")


def available_memory() -> float | None:
    """Return the memory [bytes] that this process may still occupy; None if it is unknown.

    The machine, its container and the batch job (control groups of Linux) each have a limit.
    """
    free: list[float] = []
    with suppress(OSError, KeyError):
        machine = Path("/proc/meminfo").read_text().splitlines()
        free.append(1024.0 * float(dict(ln.split()[:2] for ln in machine)["MemAvailable:"]))
        for line in Path("/proc/self/cgroup").read_text().splitlines():
            _, controllers, path = line.split(":", 2)
            base, limit, usage = Path("/sys/fs/cgroup"), "memory.max", "memory.current"
            if controllers:  # the first version of control groups, a tree for each kind
                base, limit = base / controllers, "memory.limit_in_bytes"
                usage = "memory.usage_in_bytes"
            inside = Path(path.lstrip("/"))
            for folder in (base / part for part in (inside, *inside.parents)):
                with suppress(OSError, ValueError):
                    largest, used = (float((folder / x).read_text()) for x in (limit, usage))
                    lines = (folder / "memory.stat").read_text().splitlines()
                    cached = dict(line.split() for line in lines)
                    free.append(largest - used + float(cached.get("inactive_file", 0)))
    return min(free, default=None)
