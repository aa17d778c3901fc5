"""Peak memory of a run: the most that the process held resident while it went on."""

from __future__ import annotations

import sys
from pathlib import Path

__all__ = ["peak_memory", "reset_peak"]

CLEAR = Path("/proc/self/clear_refs")
STATUS = Path("/proc/self/status")
RESET_PEAK = "5"
"""What Linux takes for: set the peak to what is resident now (proc(5), since 4.0)."""


def reset_peak() -> bool:
    """Begin a new peak; False where the system cannot, so that the peak is that of all runs."""
    try:
        CLEAR.write_text(RESET_PEAK)
    except OSError:
        return False
    return True


def peak_memory() -> float:
    """Most memory resident since the last reset [bytes], the interpreter and libraries included.

    Where there is no /proc it is the most since the process began; NaN where nothing tells.
    """
    try:
        lines = STATUS.read_text().splitlines()
    except OSError:
        return _since_the_start()
    for line in lines:
        if line.startswith("VmHWM:"):
            return 1024.0 * float(line.split()[1])
    return _since_the_start()


def _since_the_start() -> float:
    try:
        import resource
    except ImportError:  # not on this system
        return float("nan")
    unit = 1 if sys.platform == "darwin" else 1024
    return float(unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
