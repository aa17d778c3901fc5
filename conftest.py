"""Tests use the installed package, not the source tree that `python -m pytest` is started in."""

import sys
from pathlib import Path

HERE = str(Path(__file__).parent)
sys.path[:] = [entry for entry in sys.path if entry not in ("", HERE)]
