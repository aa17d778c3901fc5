"""A case as data: runs of a scene, how they are measured, and the bounds decided beforehand."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from swe_sphere.files.fingerprints import code_fingerprint, fingerprint
from swe_sphere.settings.values import by_field
from swe_sphere.simulation.config import RunConfig, make_config
from swe_sphere.studies.cases.scenes import make_scene

Norms = tuple[float, float, float]
"""l1, l2 and linf."""
Limits = Mapping[str, float | Mapping[Literal["low", "high"], float]]
"""Limits by quantity: `quantity = high`, or `quantity = {low = low, high = high}`."""

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


@dataclass(frozen=True)
class Check:
    """Limits of a quantity, decided before the run, and the number that is compared with them."""

    quantity: str
    high: float = math.inf
    low: float = -math.inf
    always: bool = False
    """Whether it also applies to a run that was stopped early."""
    obtained: float = math.nan
    """NaN for a quantity that was not measured."""

    @property
    def holds(self) -> bool:
        """Whether the number is within its limits; NaN is not."""
        return self.low <= self.obtained <= self.high

    @property
    def used(self) -> float:
        """Fraction of the limit that is used: at most 1 within it, infinite for NaN."""
        x, high = self.obtained, self.high
        if not math.isfinite(x):
            return math.inf
        if math.isinf(self.high):
            x, high = -x, -self.low
        elif math.isfinite(self.low):
            high = 0.5 * (self.high - self.low)
            x = abs(x - (self.low + high))
        if high > 0.0:
            return max(x, 0.0) / high
        if high < 0.0 and x < 0.0:
            return high / x
        return 0.0 if x <= high else math.inf

    @property
    def limits(self) -> str:
        """The limits in words."""
        if math.isinf(self.high):
            return f"{self.quantity} ≥ {self.low:g}"
        low = "" if math.isinf(self.low) else f"{self.low:g} ≤ "
        return f"{low}{self.quantity} ≤ {self.high:g}"

    def __str__(self) -> str:
        return f"{self.quantity} is {self.obtained:.6g}, not {self.limits}"


def read_limits(table: Limits, always: bool = False) -> Iterator[Check]:
    """Yield a check for each quantity that is limited; always: as `Check.always`."""
    for quantity, limits in table.items():
        values = {"high": limits} if isinstance(limits, float) else limits
        check = Check(quantity, values.get("high", math.inf), values.get("low", -math.inf), always)
        if not (math.isinf(check.high) and math.isinf(check.low)):
            yield check


class Level(BaseModel):
    """One run of a case and its own bounds; all other keys are changes of the run of the case."""

    model_config = ConfigDict(frozen=True, extra="allow")
    __pydantic_extra__: dict[str, Any] = Field(init=False)

    h: Norms | None = None
    v: Norms | None = None
    order: tuple[float] | tuple[float, float] | None = None
    bounds: Limits = {}
    values: dict[str, float] = {}
    published: Mapping[str, Mapping[str, float]] = {}
    quick: bool = False


class Case(BaseModel):
    """A scene that is run once or at several levels, and what its numbers must keep.

    The fields are the keys of files of cases, which verification/start.toml documents.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    family: str = ""
    """Name of the file."""
    title: str = ""
    run: dict[str, Any]
    method: Literal["errors", "start", "series", "file", "precisions", "seeds"] = "errors"
    levels: tuple[Level, ...] = (Level(quick=True),)
    along: Literal["ne", "np", "dt"] = "ne"
    against: str | dict[str, Any] | None = None
    tolerance: float = 1e-3
    bounds: Limits = {}
    always: Limits = {}
    expect: Literal["pass", "either", "refuse", "break"] = "pass"
    part: float | None = None
    courant: float | None = None
    advective: float | None = None
    """Largest advective Courant number of a step that follows `courant`."""
    steps: int | None = None
    symmetries: tuple[str, ...] = ()
    seeds: tuple[int, ...] = ()
    """Seeds of a batch of random states."""
    seconds: float | None = None
    report: tuple[str, ...] = ()
    note: str = ""
    quickly: dict[str, Any] = {}

    def configured(self, changes: Mapping[str, Any] | None = None) -> RunConfig:
        """Return the configuration of the run with changes; ConfigError for what does not fit."""
        limit = {} if self.seconds is None else {"time-limit": self.seconds}
        return make_config(by_field(merged(limit | self.run, changes or {})))

    def at(self, level: Level) -> RunConfig:
        """Return the run of a level."""
        return self.configured(level.__pydantic_extra__)

    def changed(self, **changes: Any) -> Case:
        """Return the case with other values; those in `run` are merged with its own."""
        run = merged(self.run, changes.pop("run", {}))
        return Case.model_validate(self.model_dump() | {"run": run} | changes)

    def quick_form(self) -> Case:
        """Return the case of the quick form, which may have no levels."""
        levels = tuple(level for level in self.levels if level.quick)
        short = self.changed(**self.quickly) if self.quickly and levels else self
        return short.model_copy(update={"levels": levels})

    def checks(self, level: Level) -> list[Check]:
        """Return all checks of a level; those that always apply come first."""
        norms = zip(NORMS, (level.h or 3 * (math.inf,)) + (level.v or ()), strict=False)
        orders = zip(("order", "order_v"), level.order or (), strict=False)
        room = {name: self.tolerance * abs(value) for name, value in level.values.items()}
        return [
            *read_limits(self.always, always=True),
            *read_limits(dict(norms)),
            *(Check(name, low=low) for name, low in orders),
            *read_limits(level.bounds),
            *(Check(n, x + room[n], x - room[n]) for n, x in level.values.items()),
            *read_limits(self.bounds),
        ]

    @property
    def is_timed(self) -> bool:
        """Whether there are bounds on its times, so that it has to run alone."""
        checks = (check for level in self.levels for check in self.checks(level))
        return any("seconds" in check.quantity for check in checks)

    def fingerprint(self, level: Level) -> str:
        """Return the same text for two levels with the same run, measurement and code."""
        judged = {"levels", "bounds", "always", "expect", "tolerance", "title", "note", "report"}
        run = self.model_dump(exclude=judged | {"family", "along", "quickly"})
        return fingerprint([level.__pydantic_extra__, run, code_fingerprint("studies.cases")])

    @property
    def stepper(self) -> str:
        """Name of the stepper that the run states."""
        return str(self.run["stepper"])

    @property
    def scene(self) -> str:
        """Name of the scene."""
        return make_scene(self.configured()).name


def merged(table: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table with changes; tables within it are merged too."""
    deep = {
        key: merged(table[key], value)
        for key, value in changes.items()
        if isinstance(value, Mapping) and isinstance(table.get(key), Mapping)
    }
    return {**table, **changes, **deep}
