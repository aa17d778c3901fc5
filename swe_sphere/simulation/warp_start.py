"""Starting Warp without its greeting, which would stand in the output of every run."""

import os
import sys
import tempfile

EXPECTED = b"Could not find or load the NVIDIA CUDA driver"
"""What Warp's native library writes to stderr on every machine without a GPU."""


def start_warp() -> None:
    """Import and initialise Warp; warnings and errors still come through, but for that one."""
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    with tempfile.TemporaryFile() as caught:
        sys.stderr.flush()
        stderr = os.dup(2)
        os.dup2(caught.fileno(), 2)
        try:
            wp.init()
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
            caught.seek(0)
            for line in caught:
                if EXPECTED not in line:
                    os.write(2, line)
