"""Memory that this process may still occupy: of the machine, of its container or batch job."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

GROUPS = Path("/sys/fs/cgroup")


def available_memory() -> float | None:
    """Return the memory [bytes] that this process may still occupy; None where it is unknown."""
    known = [free for free in (_of_machine(), _of_group()) if free is not None]
    return min(known, default=None)


def _of_machine() -> float | None:
    """Return what the machine can give without swapping, or else what is installed."""
    with suppress(OSError, StopIteration):
        lines = Path("/proc/meminfo").read_text().splitlines()
        return 1024.0 * float(next(ln for ln in lines if ln.startswith("MemAvailable:")).split()[1])
    with suppress(AttributeError, ValueError, OSError):
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return None


def _of_group() -> float | None:
    """Return what the limits of control groups (Linux) leave, without pages of files."""
    free: list[float] = []
    with suppress(OSError):
        for line in Path("/proc/self/cgroup").read_text().splitlines():
            _, controllers, path = line.split(":", 2)
            base, limit, usage = GROUPS, "memory.max", "memory.current"
            if controllers:  # the first version of control groups, a tree for each kind
                base = GROUPS / controllers
                limit, usage = "memory.limit_in_bytes", "memory.usage_in_bytes"
            inside = Path(path.lstrip("/"))
            for folder in (base / part for part in (inside, *inside.parents)):
                with suppress(OSError, ValueError):
                    largest, used = (float((folder / x).read_text()) for x in (limit, usage))
                    lines = (folder / "memory.stat").read_text().splitlines()
                    cached = dict(line.split() for line in lines)
                    free.append(largest - used + float(cached.get("inactive_file", 0)))
    return min(free, default=None)
