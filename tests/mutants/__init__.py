"""Single faults that the quick verification must notice.

`python -m mutants` (in `tests`) plants all of them, one by one, and writes docs/mutants.md.
"""

from __future__ import annotations

from mutants.edits import EDITS
from mutants.kinds import Edit, Mutant, Swap
from mutants.swaps import SWAPS

__all__ = ["EDITS", "MUTANTS", "SWAPS", "Edit", "Mutant", "Swap"]

MUTANTS: tuple[Swap | Edit, ...] = (*SWAPS, *EDITS)
"""All mutants."""
