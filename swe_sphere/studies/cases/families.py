"""The cases of `swe-sphere verify` and `swe-sphere stress`, by family, from the files beside it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Self

from pydantic import ValidationError, model_validator

from swe_sphere.errors import ConfigError, unknown_name
from swe_sphere.settings.values import place_and_complaint, read_toml
from swe_sphere.steppers import STEPPERS, get_stepper
from swe_sphere.studies.cases.case import Case, Level, merged
from swe_sphere.studies.cases.scenes import random_setting

FAMILIES = {
    "verification": (
        "start", "transport", "steady", "unsteady", "rest", "jet", "reference", "finer",
        "conservation", "dissipation", "steppers",
    ),
    "stability": (
        "rossby-haurwitz", "galewsky", "steady", "mountain", "bottoms", "depth", "noise", "random",
        "precision", "long-steps", "tilted", "stretched", "planets", "rest", "modons", "guards",
    ),
}  # fmt: skip
"""Folders of files of cases, and the files in the order of the page."""

DEFAULTS: dict[str, dict[str, Any]] = {
    "verification": {
        "run": {"ne": 8, "np": 4, "days": 5.0},
        "bounds": {"mass_drift": 1e-13},
    },
    "stability": {"method": "series", "seconds": 900.0},
}
"""What all cases of a folder share unless a file says otherwise."""

QUICK_SEEDS = 2


class Table(Case):
    """A table [[case]] of a file; with steppers it is a case for each, called NAME-STEPPER."""

    steppers: tuple[str, ...] = ()
    random: int = 0
    remedy: Mapping[str, dict[str, Any]] = {}
    remedied: tuple[str, ...] | None = None
    quick: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _keys_are_used(self) -> Self:
        """Refuse keys that a table with steppers, or one without, would ignore."""
        ignored = (
            ("levels", "seeds") if self.steppers else ("random", "remedy", "remedied", "quick")
        )
        for name in ignored:
            if name in self.model_fields_set:
                rule = "cannot be given beside" if self.steppers else "needs"
                raise ValueError(f"{self.name}: {name} {rule} steppers")
        if self.method == "series" and not self.steppers and "stepper" not in self.run:
            raise ValueError(f"{self.name}: give steppers, or run.stepper")
        return self

    def cases(self) -> Iterator[Case]:
        """Yield all cases; one with the remedy, which must pass, after the one that may break."""
        own = self.model_dump(include=set(Case.model_fields) & self.model_fields_set)
        if not self.steppers:
            yield Case.model_validate(own)
            return
        names = named_steppers(self.steppers)
        for index, stepper in enumerate(names):
            seeds = range(index, self.random, len(names))
            # other np than 4 compile more kernels
            few = [seed for seed in seeds if random_setting(seed)[0]["np"] == 4][:QUICK_SEEDS]
            case = Case.model_validate(own | {
                "name": f"{self.name}-{stepper}",
                "run": self.run | {"stepper": stepper},
                "seeds": tuple(seeds),
                "levels": (Level(quick=stepper in self.quick),),
                "quickly": self.quickly | ({"seeds": few} if seeds else {}),
            })  # fmt: skip
            if not self.remedy:
                yield case
                continue
            is_needed = self.remedied is None or stepper in self.remedied
            usual = "break" if is_needed else "either"
            yield case.changed(expect=self.expect if "expect" in own else usual)
            if is_needed:
                name = f"{case.name}+{next(iter(self.remedy))}"
                yield case.changed(name=name, run={"set": self.remedy}, levels=(Level(),))


def named_steppers(words: tuple[str, ...]) -> list[str]:
    """Return steppers by name: all of a family, all of "all", or single ones."""
    found: dict[str, None] = {}
    for word in words:
        family = [name for name, kind in STEPPERS.items() if word in ("all", kind.family)]
        found |= dict.fromkeys(family or [get_stepper(word).name])
    return list(found)


@dataclass(frozen=True)
class Family:
    """Cases that belong together."""

    name: str
    title: str
    text: str
    """Paragraph of the page: what is run, and what is required."""
    cases: tuple[Case, ...]


@cache
def families(folder: str) -> Mapping[str, Family]:
    """Return all families of "verification" or "stability" by name."""
    place = Path(__file__).parent / folder
    return {
        name: read_family(place / f"{name}.toml", DEFAULTS[folder]) for name in FAMILIES[folder]
    }


def read_family(path: Path, defaults: Mapping[str, Any] | None = None) -> Family:
    """Return the family in a file: its tables [[case]], each merged with the table [shared].

    Raises:
        ConfigError: the file cannot be read, or is not as `Table` says.
    """
    whole = read_toml(path)
    shared, tables = merged(defaults or {}, whole.pop("shared", {})), whole.pop("case", None)
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise ConfigError(f"{path}: there must be tables [[case]]")
    shared["family"] = path.stem
    try:
        read = [Table.model_validate(merged(shared, table)) for table in tables]
    except ValidationError as error:
        raise ConfigError(f"{path}: {place_and_complaint(error)}") from None
    cases = tuple(case for table in read for case in table.cases())
    return Family(path.stem, whole.get("title", path.stem), whole.get("text", ""), cases)


def all_cases(folder: str) -> list[Case]:
    """Return the cases of all families of "verification" or "stability", in order."""
    return [case for family in families(folder).values() for case in family.cases]


def choose_verification(
    names: Sequence[str] = (), quick: bool = False, launch: str | None = None
) -> list[Case]:
    """Return the cases of these scenes, or of these names (none: all), with a shape of launches.

    Raises:
        ConfigError: an unknown name or shape.
    """
    chosen = all_cases("verification")
    if names:
        own = {case.name: {case.scene, case.name} for case in chosen}
        known = dict.fromkeys(name for each in own.values() for name in sorted(each))
        _check_names("scene or case", names, known)
        chosen = [case for case in chosen if own[case.name] & set(names)]
    if launch is not None:
        chosen = [case.changed(run={"launch": launch}) for case in chosen]
        chosen[0].configured()  # an unknown shape ends here
    return _quick(chosen) if quick else chosen


def choose_stability(
    groups: Sequence[str] = (), steppers: Sequence[str] = (), quick: bool = False
) -> list[Case]:
    """Return the cases of these families and of these steppers (none: all).

    Raises:
        ConfigError: an unknown name, or no case is left.
    """
    known = families("stability")
    _check_names("group of cases", groups, known)
    wanted = {get_stepper(name).name for name in steppers}
    every = [case for name in groups or known for case in known[name].cases]
    chosen = [case for case in every if not wanted or case.stepper in wanted]
    chosen = _quick(chosen) if quick else chosen
    if not chosen:
        raise ConfigError("no case is left: ask for other groups or steppers, or not --quick")
    return chosen


def _check_names(what: str, names: Sequence[str], known: Mapping[str, object]) -> None:
    for name in names:
        if name not in known:
            raise unknown_name(what, name, known)


def _quick(cases: list[Case]) -> list[Case]:
    return [case.quick_form() for case in cases if any(level.quick for level in case.levels)]
