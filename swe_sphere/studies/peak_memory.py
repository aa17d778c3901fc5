"""Peak memory of one run among many in a process."""

from __future__ import annotations

import ctypes
import gc
import re
import sys
from contextlib import suppress
from pathlib import Path


def begin_peak() -> bool:
    """Free the memory of earlier runs and begin a new peak; False where the system cannot."""
    gc.collect()
    with suppress(OSError, AttributeError):  # where the C library can (glibc)
        ctypes.CDLL(None).malloc_trim(0)
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")  # resets the peak: proc(5), Linux 4.0
        return True
    return False


def peak_memory() -> float:
    """Return the most memory resident since `begin_peak` [bytes], with interpreter and libraries.

    Without /proc it is the most since the process began; NaN where the system reports neither.
    """
    with suppress(OSError):
        if found := re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text()):
            return 1024.0 * float(found[1])
    try:
        import resource
    except ImportError:  # not on this system
        return float("nan")
    unit = 1 if sys.platform == "darwin" else 1024
    return float(unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
