"""A case as data: runs of a scene, how they are measured, and the bounds decided beforehand."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from swe_sphere.files.fingerprints import code_fingerprint, fingerprint
from swe_sphere.studies.cases.bounds import Bound, Limits, read_bounds
from swe_sphere.studies.cases.configuration import Configuration, merged

Norms = tuple[float, float, float]
"""l1, l2 and linf."""

CONVERGED = "converged"
"""Value of `Case.against` for a run on the same mesh with a step too short for a time error."""

NORMS = tuple(f"{norm}_{name}" for name in "hv" for norm in ("l1", "l2", "linf"))
"""Names of the six normalised errors."""

ORDERS = {
    "l2_h": "order",
    "l2_v": "order_v",
    "energy_drift": "order_energy",
    "l2_q_gaussian_hills": "order_q",
}
"""Quantities that fall with refinement, and the names of their observed orders."""


class Published(BaseModel):
    """Published numbers for comparison: values by quantity, and their source."""

    model_config = ConfigDict(frozen=True, extra="allow")
    __pydantic_extra__: dict[str, float]

    source: str

    @property
    def values(self) -> Mapping[str, float]:
        """Values by quantity."""
        return self.__pydantic_extra__


class Level(BaseModel):
    """One run of a case and its own bounds; all other keys are changes of the run of the case."""

    model_config = ConfigDict(frozen=True, extra="allow")
    __pydantic_extra__: dict[str, Any] = Field(init=False)

    h: Norms | None = None
    """Upper bounds of l1, l2, linf of the height."""
    v: Norms | None = None
    """Upper bounds of l1, l2, linf of the wind."""
    order: tuple[float] | tuple[float, float] | None = None
    """Lower bounds of the orders of height and wind since the level before."""
    bounds: Limits = {}
    """Bounds of other quantities.  An upper bound alone limits the size; one of an order does not
    apply to the first level of a run."""
    values: dict[str, float] = {}
    """Numbers to be met to within `Case.tolerance`."""
    published: tuple[Published, ...] = ()
    quick: bool = False
    """Whether the level is part of the quick form."""

    def all_bounds(self, tolerance: float) -> Iterator[Bound]:
        """Yield all bounds of the level; tolerance: relative, of `values`."""
        for names, limits in ((NORMS[:3], self.h), (NORMS[3:], self.v)):
            yield from read_bounds(dict(zip(names, limits or (), strict=False)))
        for name, low in zip(("order", "order_v"), self.order or (), strict=False):
            yield Bound(name, low=low)
        yield from read_bounds(self.bounds)
        for name, value in self.values.items():
            room = tolerance * abs(value)
            yield Bound(name, value + room, value - room)


class Case(BaseModel):
    """A scene that is run once or at several levels, and what its numbers must keep."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    """Name of the case, different from those of all others."""
    title: str = ""
    run: dict[str, Any]
    """The run with the keys of a `--config` file, see `Configuration`."""
    method: Literal["errors", "start", "series", "file", "precisions", "seeds"] = "errors"
    """How a run is measured, see `measure.METHODS`."""
    levels: tuple[Level, ...] = (Level(quick=True),)
    along: Literal["ne", "np", "dt"] = "ne"
    """What differs from level to level; the observed order is in terms of it."""
    against: str | dict[str, Any] | None = None
    """Where errors are measured from: a shipped reference "scene_dayD", a run with these changes
    on a finer mesh, or `CONVERGED`; None: the exact solution."""
    tolerance: float = 1e-3
    """Relative, of the `values` of the levels."""
    bounds: Limits = {}
    """Bounds of all levels."""
    always: Limits = {}
    """Bounds that also apply to a run that was stopped early."""
    expect: Literal["pass", "either", "refuse", "break"] = "pass"
    """pass: the run must end within its bounds.  refuse: it must stop itself with a reason.
    either: one of these two.  break: it may exceed its bounds, because the same case follows with
    a remedy and must pass."""
    part: float | None = None
    """The step as a fraction of the stepper's own stability limit."""
    courant: float | None = None
    """The step in units of the gravity-wave limit 1/ρ, ρ the spectral radius at the start."""
    advective: float | None = None
    """Largest advective Courant number of a step that follows `courant`."""
    steps: int | None = None
    """Length of the run in steps; with days in `run`, whichever is shorter."""
    symmetries: tuple[str, ...] = ()
    """Symmetries that are measured as well: keys of `series.SYMMETRIES`."""
    seeds: tuple[int, ...] = ()
    """Seeds of a batch of random states."""
    seconds: float | None = None
    """Wall time that the steps may take [s]; a run that uses it up has failed."""
    report: tuple[str, ...] = ()
    """Quantities without a bound that the page shows."""
    note: str = ""
    quickly: dict[str, Any] = {}
    """Changes of the case in the quick form."""

    @property
    def base(self) -> Configuration:
        """The run of the case before its levels change it."""
        limit = {} if self.seconds is None else {"time-limit": self.seconds}
        return Configuration(limit | self.run)

    def at(self, level: Level) -> Configuration:
        """Return the run of a level."""
        return self.base.changed(level.__pydantic_extra__)

    def changed(self, **changes: Any) -> Case:
        """Return the case with other values; those in `run` are merged with its own."""
        run = merged(self.run, changes.pop("run", {}))
        return Case.model_validate(self.model_dump() | {"run": run} | changes)

    def quick_form(self) -> Case:
        """Return the case of the quick form, which may have no levels."""
        levels = tuple(level for level in self.levels if level.quick)
        short = self.changed(**self.quickly) if self.quickly and levels else self
        return short.model_copy(update={"levels": levels})

    def all_bounds(self, level: Level) -> list[Bound]:
        """Return all bounds of a level; bounds that always apply come first."""
        always = read_bounds(self.always, always=True)
        return [*always, *level.all_bounds(self.tolerance), *read_bounds(self.bounds)]

    @property
    def is_timed(self) -> bool:
        """Whether there are bounds on its times, so that it has to run alone."""
        bounds = (bound for level in self.levels for bound in self.all_bounds(level))
        return any("seconds" in bound.quantity for bound in bounds)

    def fingerprint(self, level: Level) -> str:
        """Return the same text for two levels with the same run, measurement and code."""
        judged = {"levels", "bounds", "always", "expect", "tolerance", "title", "note", "report"}
        run = self.model_dump(exclude=judged | {"along", "quickly"})
        return fingerprint([self.at(level).table, run, code_fingerprint("studies.cases")])

    @property
    def stepper(self) -> str:
        """Name of the stepper that the run states."""
        return str(self.run["stepper"])

    @property
    def scene(self) -> str:
        """Name of the scene."""
        return self.base.make_scene().name
