"""The command line: thin; everything it does is also a function of the package."""

import gc
import os
import sys

__all__ = ["main"]


def main() -> None:
    """The program `swe-sphere`; Ctrl-C ends it with one line even while it is still loading."""
    # a run uses one core, and threads that wait for a share of its small matrices only spin
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.set_threshold(20_000)  # what loading makes stays: looking for garbage in it is in vain
    try:
        from swe_sphere.cli.main import main as program

        program()
    except KeyboardInterrupt:
        sys.stderr.write("swe-sphere: interrupted by Ctrl-C\n")
        sys.exit(130)
