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
    with suppress(OSError):
        lines = Path("/proc/self/cgroup").read_text().splitlines()
        free = [_left(*place) for line in lines for place in _places(*line.split(":", 2)[1:])]
        return min((known for known in free if known is not None), default=None)
    return None


def _places(controllers: str, path: str) -> list[tuple[Path, str, str]]:
    """Return folders of a control group and those above it, with names of limit and usage."""
    if controllers == "":  # the second version of Linux control groups
        base, limit, usage = GROUPS, "memory.max", "memory.current"
    elif "memory" in controllers.split(","):
        base, limit, usage = GROUPS / "memory", "memory.limit_in_bytes", "memory.usage_in_bytes"
    else:
        return []
    inside = Path(path.lstrip("/"))
    return [(base / part, limit, usage) for part in (inside, *inside.parents)]


def _left(folder: Path, limit: str, usage: str) -> float | None:
    with suppress(OSError, ValueError):
        largest, used = (float((folder / name).read_text()) for name in (limit, usage))
        lines = (folder / "memory.stat").read_text().splitlines()
        cached = dict(line.split() for line in lines)
        return largest - used + float(cached.get("inactive_file", 0))
    return None
