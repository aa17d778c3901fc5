"""The command line: a thin layer; the package has a function for everything it does."""

import gc
import os
import sys


def main() -> None:
    """Run the program `swe-sphere`; Ctrl-C ends it with one line even while it is loading."""
    # a run uses one core, and idle BLAS threads would only spin
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.set_threshold(20_000)  # imported objects stay: collecting garbage among them is wasted time
    try:
        from swe_sphere.cli.main import main as program

        program()
    except KeyboardInterrupt:
        sys.stderr.write("swe-sphere: interrupted by Ctrl-C\n")
        sys.exit(130)
