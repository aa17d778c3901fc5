"""Single faults that the quick verification, or a test, must notice.

`python -m mutants` (in `tests`) plants all of them, one by one, and
writes benchmarks/results/mutants.json.
"""

from __future__ import annotations

from mutants.edits import EDITS
from mutants.kinds import Edit, Mutant, Swap, Tested
from mutants.result_edits import RESULT_EDITS
from mutants.step_edits import STEP_EDITS
from mutants.swaps import SWAPS

__all__ = [
    "EDITS",
    "MUTANTS",
    "RESULT_EDITS",
    "STEP_EDITS",
    "SWAPS",
    "Edit",
    "Mutant",
    "Swap",
    "Tested",
]

MUTANTS: tuple[Swap | Edit, ...] = (*SWAPS, *EDITS, *STEP_EDITS, *RESULT_EDITS)
"""All mutants."""
