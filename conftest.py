"""Tests use the installed package, not the source tree that `python -m pytest` is started in."""

import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does, before numpy loads

HERE = str(Path(__file__).parent)
sys.path[:] = [entry for entry in sys.path if entry not in ("", HERE)]
