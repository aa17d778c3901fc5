"""All cases, family by family: those in the files of `cases/`, and one for each stepper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from pathlib import Path
from types import MappingProxyType

from swe_sphere.errors import unknown_name
from swe_sphere.steppers import STEPPERS, Stepper
from swe_sphere.studies.configuration import read_tables
from swe_sphere.studies.verify.case import CONVERGED, Case, Level

__all__ = ["all_cases", "choose", "families", "read_cases"]

FILES = (
    "start", "transport", "steady", "unsteady", "rest", "jet", "reference", "finer",
    "conservation", "dissipation",
)  # fmt: skip
"""In the order of the page."""


@cache
def families() -> Mapping[str, tuple[Case, ...]]:
    """Cases by the title of their family."""
    folder = Path(str(resources.files("swe_sphere.studies.verify"))) / "cases"
    found = dict(read_cases(folder / f"{name}.toml") for name in FILES)
    steppers = [kind for kind in STEPPERS.values() if kind.expected_error]
    return MappingProxyType(found | {"Steppers": tuple(map(_stepper_case, steppers))})


def all_cases() -> tuple[Case, ...]:
    """The cases of all families."""
    return tuple(case for cases in families().values() for case in cases)


def choose(names: Sequence[str]) -> tuple[Case, ...]:
    """The cases of these scenes, or of these names; all of them where none is given.

    Raises ConfigError for a name that is neither.
    """
    if not names:
        return all_cases()
    named = [(case, {case.scene, case.name}) for case in all_cases()]
    known = dict.fromkeys(name for _, own in named for name in sorted(own))
    for name in names:
        if name not in known:
            raise unknown_name("scene or case", name, known)
    return tuple(case for case, own in named if own & set(names))


def read_cases(path: Path) -> tuple[str, tuple[Case, ...]]:
    """Title and cases of a file; ConfigError for one that is not as its schema says."""
    whole, cases = read_tables(path, "case", Case)
    return str(whole.get("title", path.stem)), cases


def _stepper_case(kind: type[Stepper]) -> Case:
    """The time error of a stepper, on a mesh so coarse that a converged run costs nothing.

    The error of a scheme is a number like any other: a coefficient, a filter or a start that is
    wrong by a little changes it, also where the order stays.
    """
    solves = kind.family != "explicit"
    levels = tuple(
        Level(run={"dt": dt}, values={"l2_h": height, "l2_v": wind}, quick=True)
        for dt, height, wind in kind.expected_error
    )
    return Case(
        name=f"stepper-{kind.name}",
        title=f"{kind.name}, order {kind.order}",
        run={"scene": "lauter", "ne": 3, "days": 0.125, "stepper": kind.name}
        | ({"tolerance": 1e-11} if solves else {}),
        levels=levels,
        along="dt",
        against=CONVERGED,
        # small errors feel what the solver leaves, which depends on the order of sums
        tolerance=2e-3 if solves and kind.order == 4 else 3e-4,
    )
