"""Tests use the installed package: the source tree alone lacks `kernels` and `testcases`."""

import sys
from pathlib import Path

HERE = str(Path(__file__).parent)
sys.path[:] = [entry for entry in sys.path if entry not in ("", HERE)]
