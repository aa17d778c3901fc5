"""Peak memory of one run among many in a process."""

from __future__ import annotations

import ctypes
import gc
import re
import sys
from contextlib import suppress
from pathlib import Path

CLEAR = Path("/proc/self/clear_refs")
STATUS = Path("/proc/self/status")
RESET_PEAK = "5"
"""What Linux takes for: set the peak to what is resident now (proc(5), since 4.0)."""


def begin_peak() -> bool:
    """Give back what earlier runs have left, and begin a new peak.

    False where the system cannot, so that the peak is that of all runs so far.
    """
    gc.collect()
    with suppress(OSError, AttributeError):  # where the C library can (glibc)
        ctypes.CDLL(None).malloc_trim(0)
    try:
        CLEAR.write_text(RESET_PEAK)
    except OSError:
        return False
    return True


def peak_memory() -> float:
    """Most memory resident since `begin_peak` [bytes], the interpreter and libraries included.

    Where there is no /proc it is the most since the process began; NaN where nothing tells.
    """
    try:
        found = re.search(r"VmHWM:\s+(\d+)", STATUS.read_text())
    except OSError:
        found = None
    return 1024.0 * float(found[1]) if found else _since_the_start()


def _since_the_start() -> float:
    try:
        import resource
    except ImportError:  # not on this system
        return float("nan")
    unit = 1 if sys.platform == "darwin" else 1024
    return float(unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
