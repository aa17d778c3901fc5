"""What a stress trial is, as data: a run, bounds decided beforehand, and what may come of it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

from swe_sphere.errors import ConfigError, unknown_name
from swe_sphere.files.fingerprints import code_fingerprint, fingerprint
from swe_sphere.steppers import STEPPERS, get_stepper
from swe_sphere.studies import record_store
from swe_sphere.studies.configuration import Configuration, merged, read_tables, study_files
from swe_sphere.studies.ended import STOPPED, Bound, Check, Ended, Limits, read_bounds
from swe_sphere.studies.stress.random_state import random_setting

FILES = (
    "rossby-haurwitz", "galewsky", "steady", "mountain", "bottoms", "depth", "noise", "random",
    "precision", "long-steps", "stretched", "planets", "rest", "modons", "guards",
)  # fmt: skip
"""Of groups, in the order of the page."""

OUTCOMES = ("passed", "refused", "broke", "failed")
QUICK_SEEDS = 2


class _Asked(BaseModel):
    """What a trial and a table of trials have in common."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    """Unlike that of any other trial."""
    run: dict[str, Any]
    """As in a `--config` file, see `Configuration`."""
    bounds: Limits = {}
    always: Limits = {}
    """Bounds that hold also for a run that was stopped early."""
    expect: Literal["pass", "either", "refuse", "break"] = "pass"
    """pass: must end within its bounds; refuse: must stop itself and say why; either: one of
    these two; break: it may also go beyond its bounds, as a trial with a remedy follows."""
    method: Literal["run", "file", "precisions", "seeds"] = "run"
    """How it is measured, see `methods`."""
    part: float | None = None
    """The step as a part of the stepper's own stability limit."""
    courant: float | None = None
    """The step in units of the gravity-wave limit 1/ρ, ρ the spectral radius at the start."""
    advective: float | None = None
    """Largest advective Courant number of a step that follows `courant`."""
    steps: int | None = None
    """Length of the run in steps; with days in `run`, whichever is shorter."""
    symmetries: tuple[str, ...] = ()
    """What is watched besides the usual: keys of `symmetries.SYMMETRIES`."""
    report: tuple[str, ...] = ()
    """Numbers worth telling that have no bound."""
    seconds: float = 900.0
    """Wall time that its steps may take [s]; using it up is a failure."""


class Trial(_Asked):
    """One run that is to be survived."""

    seeds: tuple[int, ...] = ()
    """Of a trial that is a batch of random ones."""
    quick: dict[str, Any] | None = None
    """Changes of the trial for the quick form; None: it is not in it."""

    @property
    def stepper(self) -> str:
        """Name of the stepper."""
        return str(self.run["stepper"])

    @property
    def all_bounds(self) -> tuple[Bound, ...]:
        """Those that hold always, and then the others."""
        return (*read_bounds(self.always, always=True), *read_bounds(self.bounds))

    @property
    def timed(self) -> bool:
        """Whether something is asked of its times."""
        return any("seconds" in bound.quantity for bound in self.all_bounds)

    @property
    def configuration(self) -> Configuration:
        """The run."""
        return Configuration({"time-limit": self.seconds} | self.run)

    def changed(self, **changes: Any) -> Trial:
        """The trial with other values; those in `run` are added to it."""
        run = merged(self.run, changes.pop("run", {}))
        return Trial.model_validate(self.model_dump() | {"run": run} | changes)

    def quickly(self) -> Trial:
        """The trial of the quick form."""
        return self.changed(**(self.quick or {}))

    @property
    def fingerprint(self) -> str:
        """The same for two trials that ask for the same of the same code."""
        return fingerprint([self.model_dump(exclude={"quick"}), code_fingerprint("studies.stress")])


class Result(record_store.Result):
    """What came of a trial; `reason` says why it did not pass."""

    name: str
    stepper: str
    outcome: str
    """One of `OUTCOMES`."""
    bounds: tuple[str, ...] = ()


def judge(trial: Trial, ended: Ended) -> Result:
    """Compare how it ended with what was decided beforehand."""
    outcome, reasons = _verdict(trial, ended)
    return Result(
        name=trial.name,
        stepper=trial.stepper,
        outcome=outcome,
        reason="; ".join(filter(None, reasons)),
        numbers=ended.numbers,
        bounds=tuple(str(bound) for bound in trial.all_bounds),
        fingerprint=trial.fingerprint,
    )


def _verdict(trial: Trial, ended: Ended) -> tuple[str, list[str]]:
    """The outcome, and why it is not another one."""
    stopped = ended.status in STOPPED
    if not (stopped or ended.completed):
        return "failed", [f"{ended.status}: {ended.reason}"]
    if not stopped and trial.expect == "refuse":
        return "failed", ["it was to be refused, but ran to its end"]
    reasons = [*_broken(trial, ended, stopped), ended.reason]
    if len(reasons) > 1 or (stopped and trial.expect == "pass"):
        return ("broke" if trial.expect == "break" else "failed"), reasons
    return ("refused" if stopped else "passed"), reasons


def _broken(trial: Trial, ended: Ended, stopped: bool) -> list[str]:
    """The bounds that do not hold, in words."""
    checks = [
        Check(bound, ended.numbers.get(bound.quantity, math.nan))
        for bound in trial.all_bounds
        if bound.always or not stopped
    ]
    return [str(check) for check in checks if not check.holds]


class Table(_Asked):
    """A table of a group's file: a trial for each of some steppers, called NAME-STEPPER."""

    steppers: tuple[str, ...]
    """Names, or words for several, see `named`."""
    seeds: int = 0
    """How many random states are dealt out to the steppers."""
    remedy: dict[str, dict[str, Any]] = {}
    """Settings with which trials are made again."""
    remedied: tuple[str, ...] | None = None
    """The steppers known to need the remedy; None: all of them."""
    quick: tuple[str, ...] = ()
    """The steppers that the quick form has too, with the changes `quickly`."""
    quickly: dict[str, Any] = {}

    def trials(self) -> Iterator[Trial]:
        """All of them; a trial with the remedy, which must pass, after the one that may break."""
        for trial in self._plain():
            if not self.remedy:
                yield trial
                continue
            stated = "expect" in self.model_fields_set
            needed = self.remedied is None or trial.stepper in self.remedied
            usual = "break" if needed else "either"
            yield trial.changed(expect=self.expect if stated else usual)
            if needed:
                name = f"{trial.name}+{next(iter(self.remedy))}"
                yield trial.changed(name=name, run={"set": self.remedy}, quick=None)

    def _plain(self) -> Iterator[Trial]:
        """A trial for each stepper."""
        asked = self.model_dump(include=set(_Asked.model_fields))
        steppers = named(self.steppers)
        for index, stepper in enumerate(steppers):
            seeds = range(index, self.seeds, len(steppers))
            few = {"seeds": _few(seeds)} if seeds else {}
            own = {"name": f"{self.name}-{stepper}", "run": self.run | {"stepper": stepper}}
            yield Trial(
                **(asked | own),
                seeds=tuple(seeds),
                quick=self.quickly | few if stepper in self.quick else None,
            )


def named(words: tuple[str, ...]) -> list[str]:
    """Steppers by name: of a family, of "all", or single ones."""
    found: dict[str, None] = {}
    for word in words:
        family = [name for name, kind in STEPPERS.items() if word in ("all", kind.family)]
        found |= dict.fromkeys(family or [get_stepper(word).name])
    return list(found)


def _few(seeds: range) -> tuple[int, ...]:
    """The first ones with np 4: others compile kernels of their own."""
    return tuple(s for s in seeds if random_setting(s)[0]["np"] == 4)[:QUICK_SEEDS]


@dataclass(frozen=True)
class Group:
    """Trials that belong together."""

    name: str
    title: str
    text: str
    """What is tried and what is asked of it, as a paragraph of the page."""
    trials: tuple[Trial, ...] = ()


@cache
def groups() -> Mapping[str, Group]:
    """All groups by name."""
    return {path.stem: read_group(path) for path in study_files("stress", "groups", FILES)}


def read_group(path: Path) -> Group:
    """The group in a file; ConfigError for one that is not as its schema says."""
    whole, tables = read_tables(path, "trial", Table)
    trials = tuple(trial for table in tables for trial in table.trials())
    return Group(path.stem, str(whole["title"]), str(whole["text"]), trials)


def choose(
    names: Sequence[str] = (), steppers: Sequence[str] = (), quick: bool = False
) -> list[Group]:
    """The groups of those names (none: all) with the trials of those steppers (none: all).

    quick: only the trials of the quick form, as short as it has them.

    Raises:
        ConfigError: a name that there is not, or nothing that is left.
    """
    for name in names:
        if name not in groups():
            raise unknown_name("group of trials", name, groups())
    wanted = {get_stepper(name).name for name in steppers}
    chosen = [_limited(groups()[name], wanted, quick) for name in names or groups()]
    chosen = [group for group in chosen if group.trials]
    if not chosen:
        raise ConfigError("no trial is left: ask for other groups or steppers, or not --quick")
    return chosen


def _limited(group: Group, steppers: set[str], quick: bool) -> Group:
    trials = [trial for trial in group.trials if not steppers or trial.stepper in steppers]
    if quick:
        trials = [trial.quickly() for trial in trials if trial.quick is not None]
    return replace(group, trials=tuple(trials))
