"""Verification cases, as data: a scene at several resolutions, with bounds for each."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

from swe_sphere.errors import unknown_name
from swe_sphere.files.fingerprints import code_fingerprint, fingerprint
from swe_sphere.steppers import STEPPERS, Stepper
from swe_sphere.studies.configuration import Configuration, merged, read_tables, study_files
from swe_sphere.studies.ended import Bound, Limits, read_bounds

FILES = (
    "start", "transport", "steady", "unsteady", "rest", "jet", "reference", "finer",
    "conservation", "dissipation",
)  # fmt: skip
"""In the order of the page."""

Norms = tuple[float, float, float]
"""l1, l2 and linf."""

CONVERGED = "converged"
"""In the place of a reference: a run on the same mesh with a step so short that it has no error."""

NORMS = tuple(f"{norm}_{name}" for name in "hv" for norm in ("l1", "l2", "linf"))
"""The names of the six normalised errors."""

ORDERS = {
    "l2_h": "order",
    "l2_v": "order_v",
    "energy_drift": "order_energy",
    "l2_q_gaussian_hills": "order_q",
}
"""What falls with resolution, and the name of its observed order."""

DEFAULTS = {"ne": 8, "np": 4, "days": 5.0}
"""Of all runs, unless a case says otherwise."""


class Published(BaseModel):
    """Published numbers beside ours: values by quantity, and their source."""

    model_config = ConfigDict(frozen=True, extra="allow")
    __pydantic_extra__: dict[str, float]

    source: str

    @property
    def values(self) -> Mapping[str, float]:
        """By quantity."""
        return self.__pydantic_extra__


class Level(BaseModel):
    """One resolution of a case, and what is asked of it.

    Keys that are none of these differ from the run of the case.
    """

    model_config = ConfigDict(frozen=True, extra="allow")
    __pydantic_extra__: dict[str, Any]

    h: Norms | None = None
    """Upper bounds of l1, l2, linf of the height."""
    v: Norms | None = None
    """Upper bounds of l1, l2, linf of the wind."""
    order: tuple[float] | tuple[float, float] | None = None
    """Lower bounds of the orders of height and wind since the level before that was run."""
    bounds: Limits = {}
    """Of other quantities; an upper bound alone is one of the size, one of an order holds where the
    level is not the first one run."""
    values: dict[str, float] = {}
    """Numbers to be met to within `Case.tolerance`."""
    published: tuple[Published, ...] = ()
    quick: bool = False
    """Whether the quick form runs it too."""

    def all_bounds(self, tolerance: float) -> Iterator[Bound]:
        """All bounds; tolerance: relative, of `values`."""
        for names, limits in ((NORMS[:3], self.h), (NORMS[3:], self.v)):
            yield from read_bounds(dict(zip(names, limits or (), strict=False)))
        for name, low in zip(("order", "order_v"), self.order or (), strict=False):
            yield Bound(name, low=low)
        yield from read_bounds(self.bounds)
        for name, value in self.values.items():
            room = tolerance * abs(value)
            yield Bound(name, value + room, value - room)


class Case(BaseModel):
    """A scene run at one or more resolutions."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    title: str = ""
    run: dict[str, Any]
    """As in a `--config` file, see `Configuration`; it may lack what is in `DEFAULTS`."""
    levels: tuple[Level, ...]
    along: Literal["ne", "np", "dt"] = "ne"
    """What differs from level to level; the observed order is in terms of it."""
    start: bool = False
    """Whether only the initial state is looked at."""
    against: str | dict[str, Any] | None = None
    """What to compare with: a shipped reference "scene_dayD", a run with these changes on a finer
    mesh, or `CONVERGED`; None: the exact solution."""
    tolerance: float = 1e-3
    """Relative, of the `values` of the levels."""
    mass: float = 1e-13
    """Largest relative drift of mass; infinite where mass is not conserved."""
    note: str = ""

    @property
    def base(self) -> Configuration:
        """The run of the case before its levels change it."""
        return Configuration(DEFAULTS).changed(self.run)

    def changed(self, changes: Mapping[str, Any]) -> Case:
        """The case with these values in all its runs; ConfigError for unfit ones."""
        other = self.model_copy(update={"run": merged(self.run, changes)})
        _ = other.base.config
        return other

    def at(self, level: Level) -> Configuration:
        """The run of a level."""
        return self.base.changed(level.__pydantic_extra__)

    def bounds(self, level: Level) -> list[Bound]:
        """All that is asked of a level."""
        mass = [Bound("mass_drift", self.mass)] if math.isfinite(self.mass) else []
        return [*level.all_bounds(self.tolerance), *mass]

    def fingerprint(self, level: Level) -> str:
        """The same for two levels that ask for the same run of the same code."""
        run = [self.at(level).table, self.against, self.start]
        return fingerprint([run, self.base.table, code_fingerprint("studies.verify")])

    @property
    def scene(self) -> str:
        """Name of the scene."""
        return self.base.make_scene().name


@cache
def families() -> Mapping[str, tuple[Case, ...]]:
    """Cases by the title of their family."""
    found = dict(map(read_cases, study_files("verify", "cases", FILES)))
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
        Level.model_validate({"dt": dt, "values": {"l2_h": height, "l2_v": wind}, "quick": True})
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
        tolerance=2e-3 if solves and kind.order >= 4 else 3e-4,
    )
