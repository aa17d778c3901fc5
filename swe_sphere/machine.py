"""What measured figures hold for: the processor and the versions."""

import os
import platform
from pathlib import Path

import numpy as np

from swe_sphere import __version__


def processor() -> str:
    """The name of the processor."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def versions() -> dict[str, str]:
    """Versions of Python, of this package and of those that do its work."""
    import warp as wp

    return {
        "python": platform.python_version(),
        "warp": str(wp.__version__),
        "numpy": np.__version__,
        "swe_sphere": __version__,
    }


def machine() -> str:
    """Processor, cores, Python and Warp in a line."""
    found = versions()
    return f"{processor()}, {os.cpu_count()} cores; Python {found['python']}, Warp {found['warp']}"
