"""Cases as data: runs of scenes, how they are measured, and the bounds decided beforehand.

The cases of `swe-sphere verify` and `swe-sphere stress` are in the TOML files beside this module.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from swe_sphere.errors import ConfigError, unknown_name
from swe_sphere.files.fingerprints import code_fingerprint, fingerprint
from swe_sphere.settings.values import by_field, merged, place_and_complaint, read_toml
from swe_sphere.simulation.config import RunConfig, make_config
from swe_sphere.steppers import STEPPERS, get_stepper
from swe_sphere.studies.cases.scenes import random_setting

Norms = tuple[float, float, float]
"""l1, l2 and linf."""
Limits = Mapping[str, float | Mapping[Literal["low", "high"], float]]
"""Limits by quantity: `quantity = high`, or `quantity = {low = low, high = high}`."""

NORMS: tuple[str, ...] = tuple(f"{norm}_{name}" for name in "hv" for norm in ("l1", "l2", "linf"))
"""Names of the six normalised errors."""
DEFAULTS: dict[str, dict[str, Any]] = {
    "verification": {"run": {"ne": 8, "np": 4, "days": 5.0}, "bounds": {"mass_drift": 1e-13}},
    "stability": {"method": "series", "seconds": 900.0},
}
"""Default values of the cases in a folder; the files may override them."""


@dataclass(frozen=True)
class Check:
    """Limits of a quantity, decided before the run, and the number that is compared with them."""

    quantity: str
    high: float = math.inf
    low: float = -math.inf
    always: bool = False
    """True if the limits also apply to a run that was stopped early."""
    obtained: float = math.nan
    """NaN for a quantity that was not measured."""

    @property
    def holds(self) -> bool:
        """True if the number is within its limits; False for NaN."""
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
        """Limits in words."""
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


class Case(BaseModel):
    """A run of a scene, how it is measured, and the bounds of its numbers.

    The fields are the keys of files of cases, which verification/start.toml documents.  Cases of
    one name differ in resolution or step.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    group: str = ""
    """Name of the file."""
    title: str = ""
    run: dict[str, Any]
    method: Literal["errors", "start", "series", "seeds"] = "errors"
    along: Literal["ne", "np", "dt"] = "ne"
    against: str | dict[str, Any] | None = None
    h: Norms | None = None
    v: Norms | None = None
    order: tuple[float] | tuple[float, float] | None = None
    values: dict[str, float] = {}
    tolerance: float = 1e-3
    bounds: Limits = {}
    always: Limits = {}
    published: Mapping[str, Mapping[str, float]] = {}
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
    is_quick: bool = True
    """True if the quick form contains the case, with the changes in `quickly`."""
    quickly: dict[str, Any] = {}

    def configured(self, changes: Mapping[str, Any] | None = None) -> RunConfig:
        """Return the configuration of the run with changes; ConfigError if a value does not fit."""
        limit = {} if self.seconds is None else {"time-limit": self.seconds}
        return make_config(by_field(merged(limit | self.run, changes or {})))

    def changed(self, **changes: Any) -> "Case":
        """Return the case with other values; `run` is merged with the settings of its run."""
        run = merged(self.run, changes.pop("run", {}))
        return Case.model_validate(self.model_dump() | {"run": run} | changes)

    @property
    def checks(self) -> list[Check]:
        """All checks; those that always apply come first."""
        norms = zip(NORMS, (self.h or 3 * (math.inf,)) + (self.v or ()), strict=False)
        orders = zip(("order", "order_v"), self.order or (), strict=False)
        room = {name: self.tolerance * abs(value) for name, value in self.values.items()}
        return [
            *read_limits(self.always, always=True), *read_limits(dict(norms)),
            *(Check(name, low=low) for name, low in orders), *read_limits(self.bounds),
            *(Check(n, x + room[n], x - room[n]) for n, x in self.values.items()),
        ]  # fmt: skip

    @property
    def is_timed(self) -> bool:
        """True if there are bounds on its times, so that it must run alone."""
        return any("seconds" in check.quantity for check in self.checks)

    @property
    def fingerprint(self) -> str:
        """Text that is the same for two cases with the same name, run, measurement and code."""
        measured = {"name", "run", "method", "against", "part", "courant", "advective", "steps",
                    "symmetries", "seeds", "seconds"}  # fmt: skip
        code = code_fingerprint(*map("studies.cases.{}".format, ("case", "measure", "scenes")))
        return fingerprint([self.model_dump(include=measured), code])

    @property
    def stepper(self) -> str:
        """Name of the stepper of the run."""
        return self.configured().stepper

    @property
    def scene(self) -> str:
        """Name of the scene of the run."""
        return str(self.run["scene"]).removeprefix("cases:")


class Table(Case):
    """A table [[case]] of a file: a case for each level, or for each stepper (NAME-STEPPER)."""

    levels: tuple[dict[str, Any], ...] = ({"quick": True},)
    steppers: tuple[str, ...] = ()
    random: int = 0
    remedy: Mapping[str, dict[str, Any]] = {}
    remedied: tuple[str, ...] | None = None
    quick: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _keys_are_used(self) -> Self:
        """Refuse keys that a table with steppers, or one without, would ignore."""
        rule = "cannot be given beside" if self.steppers else "needs"
        only = ("levels", "seeds") if self.steppers else ("random", "remedy", "remedied", "quick")
        for name in only:
            if name in self.model_fields_set:
                raise ValueError(f"{self.name}: {name} {rule} steppers")
        if self.method == "series" and not self.steppers and "stepper" not in self.run:
            raise ValueError(f"{self.name}: give steppers, or run.stepper")
        return self

    def cases(self) -> Iterator[Case]:
        """Yield all cases; after each that needs the remedy, the same case with the remedy."""
        own = self.model_dump(include=set(Case.model_fields) & self.model_fields_set)
        for level in () if self.steppers else self.levels:
            keys = {key: level[key] for key in level if key in Case.model_fields and key != "run"}
            run = {key: level[key] for key in level if key not in {*keys, "quick"}}
            yield Case.model_validate(own | keys | {
                "run": merged(self.run, run), "bounds": merged(self.bounds, keys.get("bounds", {})),
                "is_quick": level.get("quick", False),
            })  # fmt: skip
        names: dict[str, None] = {}
        for word in self.steppers:
            family = [name for name, kind in STEPPERS.items() if word in ("all", kind.family)]
            names |= dict.fromkeys(family or [get_stepper(word).name])
        for index, stepper in enumerate(names):
            seeds = range(index, self.random, len(names))
            # the quick form is limited to np 4: each further np compiles further kernels
            few = [seed for seed in seeds if random_setting(seed)[0]["np"] == 4][:2]
            case = Case.model_validate(own | {
                "name": f"{self.name}-{stepper}", "run": self.run | {"stepper": stepper},
                "seeds": tuple(seeds), "is_quick": stepper in self.quick,
                "quickly": self.quickly | ({"seeds": few} if seeds else {}),
            })  # fmt: skip
            is_needed = self.remedied is None or stepper in self.remedied
            if self.remedy and "expect" not in own:
                case = case.changed(expect="break" if is_needed else "either")
            yield case
            if self.remedy and is_needed:
                name, run = f"{case.name}+{next(iter(self.remedy))}", {"set": self.remedy}
                yield case.changed(name=name, run=run, expect=self.expect, is_quick=False)


@dataclass(frozen=True)
class Group:
    """The cases of one file, a group of the page."""

    name: str
    title: str
    text: str
    """Paragraph of the page: the runs and their criteria."""
    cases: tuple[Case, ...]


@cache
def groups(folder: str) -> Mapping[str, Group]:
    """Return all groups of "verification" or "stability" by name: one for each file."""
    files = sorted((Path(__file__).parent / folder).glob("*.toml"))
    return {path.stem: read_group(path, DEFAULTS[folder]) for path in files}


def read_group(path: Path, defaults: Mapping[str, Any] | None = None) -> Group:
    """Return the group in a file: each table [[case]] with [shared]; ConfigError if unreadable."""
    whole = read_toml(path)
    shared, tables = merged(defaults or {}, whole.pop("shared", {})), whole.pop("case", None)
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise ConfigError(f"{path}: there must be tables [[case]]")
    shared["group"] = path.stem
    try:
        read = [Table.model_validate(merged(shared, table)) for table in tables]
        cases = tuple(case for table in read for case in table.cases())
    except ValidationError as error:
        raise ConfigError(f"{path}: {place_and_complaint(error)}") from None
    return Group(path.stem, whole.get("title", path.stem), whole.get("text", ""), cases)


def choose(
    folder: str, names: Sequence[str] = (), steppers: Sequence[str] = (), quick: bool = False,
    launch: str | None = None,
) -> list[Case]:  # fmt: skip
    """Return cases of "verification" or "stability" in the order of the page.

    Args:
        folder: "verification" or "stability".
        names: Names of groups, scenes or cases; none: all of them.
        steppers: Names of steppers; none: all of them.
        quick: Whether to return the quick form of the cases that have one.
        launch: Shape of kernel launches; None: as the cases state.

    Raises ConfigError for an unknown name or shape, or if no case remains.
    """
    cases = [case for group in groups(folder).values() for case in group.cases]
    known = [(case.group, case.scene, case.name) for case in cases]
    for name in names:
        if not any(name in own for own in known):
            short = dict.fromkeys(each for own in known for each in own[:2])
            raise unknown_name("group, scene or case", name, short)
    if names:
        cases = [case for case, own in zip(cases, known, strict=True) if {*own} & {*names}]
    wanted = {get_stepper(name).name for name in steppers}
    cases = [case for case in cases if not wanted or case.stepper in wanted]
    if quick:
        cases = [case.changed(**case.quickly) for case in cases if case.is_quick]
    if not cases:
        raise ConfigError("no case remains: choose other names or steppers, or leave out --quick")
    if launch is not None:
        cases = [case.changed(run={"launch": launch}) for case in cases]
        cases[0].configured()  # raises ConfigError for an unknown shape
    return cases
