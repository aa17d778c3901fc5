"""Which code of the user's own a run is made of: that of a scene, a stepper, a preconditioner."""

from __future__ import annotations

import sys
import uuid
from collections.abc import Iterable
from pathlib import Path

from swe_sphere.fingerprints import file_fingerprint

__all__ = ["users_fingerprint", "users_methods"]

SESSION = uuid.uuid4().hex
"""In the place of the fingerprint of code that is in no file: nothing of it is known later."""


def users_methods(steppers: Iterable[str], preconditioners: Iterable[str]) -> dict[str, str]:
    """Fingerprints of those that are no part of the package, by what they are.

    steppers, preconditioners: names, or files.  Raises ConfigError where there is none of a name.
    """
    from swe_sphere.solvers.preconditioners import PRECONDITIONERS
    from swe_sphere.steppers import STEPPERS

    kinds: dict[str, type] = {f"the stepper {name}": STEPPERS.find(name) for name in steppers}
    kinds |= {f"the preconditioner {name}": PRECONDITIONERS.find(name) for name in preconditioners}
    return {
        what: users_fingerprint(kind)
        for what, kind in kinds.items()
        if not kind.__module__.startswith("swe_sphere.")
    }


def users_fingerprint(item: object) -> str:
    """That of the file that a function or class stands in; where there is none, of this process."""
    file = getattr(sys.modules.get(item.__module__), "__file__", None)
    return SESSION if file is None else file_fingerprint(Path(file))
