"""All cases, family by family.

To add one, write it into the file of its family; `swe-sphere verify --scenes NAME --json` tells
what it comes to, and 1.2 times that is its bound.  What costs a second or less may be part of the
quick form, which the tests run.
"""

from __future__ import annotations

from collections.abc import Sequence

from swe_sphere.errors import unknown_name
from swe_sphere.studies.verify.case import Case
from swe_sphere.studies.verify.cases import (
    conservation,
    constants,
    dissipation,
    finer,
    jet,
    reference,
    rest,
    steady,
    steppers,
    transport,
    unsteady,
)

__all__ = ["CASES", "FAMILIES", "choose"]

FAMILIES: dict[str, tuple[Case, ...]] = {
    "The scenes as they begin": constants.CASES,
    "Transport": transport.CASES,
    "Steady flow": steady.CASES,
    "Unsteady flow": unsteady.CASES,
    "Lake at rest": rest.CASES,
    "A balanced jet": jet.CASES,
    "Against an independent model": reference.CASES,
    "Against a finer mesh": finer.CASES,
    "Energy and potential enstrophy": conservation.CASES,
    "Dissipation": dissipation.CASES,
    "Steppers": steppers.CASES,
}
"""Cases by the title of their family."""

CASES: tuple[Case, ...] = tuple(case for cases in FAMILIES.values() for case in cases)
"""All cases."""


def choose(names: Sequence[str]) -> tuple[Case, ...]:
    """The cases of these scenes, or of these names; all of them where none is given.

    Raises ConfigError for a name that is neither.
    """
    if not names:
        return CASES
    known = dict.fromkeys(name for case in CASES for name in (case.scene, case.name))
    for name in names:
        if name not in known:
            raise unknown_name("scene or case", name, known)
    return tuple(case for case in CASES if {case.scene, case.name} & set(names))
