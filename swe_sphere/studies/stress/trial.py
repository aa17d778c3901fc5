"""What a stress trial is, as data: a run, bounds decided beforehand, and what may happen to it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from swe_sphere.equations.scene import Scene
from swe_sphere.fingerprints import code_fingerprint, fingerprint

__all__ = ["Bound", "Group", "Trial", "each", "remedied"]

Expectation = Literal["pass", "either", "refuse", "break"]
HYPERVISCOSITY = "hyperviscosity.nu=default"


@dataclass(frozen=True)
class Bound:
    """One number of the run and the limits it must keep to."""

    quantity: str
    high: float = math.inf
    low: float = -math.inf
    always: bool = False
    """Whether it holds for a run that was refused too."""

    def holds(self, value: float) -> bool:
        """Whether the value is within; what is no number is not."""
        return self.low <= value <= self.high

    def __str__(self) -> str:
        if math.isinf(self.high):
            return f"{self.quantity} ≥ {self.low:g}"
        low = "" if math.isinf(self.low) else f"{self.low:g} ≤ "
        return f"{low}{self.quantity} ≤ {self.high:g}"


@dataclass(frozen=True)
class Trial:
    """One run that is to be survived."""

    name: str
    """Unlike that of any other trial."""
    run: Mapping[str, Any]
    """Fields of a `RunConfig`."""
    bounds: tuple[Bound, ...] = ()
    scene: Callable[[], Scene] | None = None
    """Makes a scene that has no name on the command line; None: the one of the run."""
    expect: Expectation = "pass"
    """pass: must end within its bounds; refuse: must stop itself and say why; either: one of
    these two; break: it may also go beyond its bounds, as a trial with a remedy follows."""
    method: str = "run"
    """How it is measured: a key of `methods.METHODS`."""
    part: float | None = None
    """The step as a part of the stepper's own stability limit."""
    courant: float | None = None
    """The step in units of the gravity-wave limit 1/ρ, ρ the spectral radius at the start."""
    advective: float | None = None
    """Largest advective Courant number of a step that follows `courant`."""
    steps: int | None = None
    """Length of the run in steps; with days in `run`, whichever is shorter."""
    probes: tuple[str, ...] = ()
    """What is watched besides the usual: keys of `probes.PROBES`."""
    report: tuple[str, ...] = ()
    """Numbers worth telling that have no bound."""
    seeds: tuple[int, ...] = ()
    """Of a trial that is a batch of random ones."""
    quick: Mapping[str, Any] | None = None
    """Changes of the trial for the quick form; None: it is not in it."""
    seconds: float = 900.0
    """Wall time that its steps may take [s]; using it up is a failure."""

    @property
    def stepper(self) -> str:
        """Name of the stepper."""
        return str(self.run["stepper"])

    def quickly(self) -> Trial:
        """The trial of the quick form."""
        changes = dict(self.quick or {})
        run = {**self.run, **changes.pop("run", {})}
        return replace(self, run=run, **changes)

    @property
    def fingerprint(self) -> str:
        """The same for two trials that ask for the same of the same code."""
        asked = (self.run, self.bounds, self.expect, self.method, self.part, self.courant,
                 self.advective, self.steps, self.probes, self.seeds)  # fmt: skip
        return fingerprint([repr(asked), code_fingerprint("studies.stress")])


@dataclass(frozen=True)
class Group:
    """Trials that belong together."""

    name: str
    title: str
    text: str
    """What is tried and what is asked of it, as a paragraph of the page."""
    trials: tuple[Trial, ...] = field(default=())


def each(steppers: Sequence[str], quick: Sequence[str] = (), **values: Any) -> list[Trial]:
    """A trial for each of the steppers, called `name`-STEPPER.

    quick: the steppers that the quick form has too, with the changes given as `quickly`.
    """
    name, changes = values.pop("name"), values.pop("quickly", {})
    run = values.pop("run")
    return [
        Trial(
            f"{name}-{stepper}",
            {**run, "stepper": stepper},
            quick=changes if stepper in quick else None,
            **values,
        )
        for stepper in steppers
    ]


def remedied(
    trials: Sequence[Trial], steppers: Sequence[str], setting: str = HYPERVISCOSITY
) -> list[Trial]:
    """The trials, which may be refused; after those of the steppers one with the remedy each.

    That one must pass.  steppers: those for which the first one is known to break, which is told
    but is no failure.
    """
    found = []
    for trial in trials:
        if trial.stepper not in steppers:
            found.append(replace(trial, expect="either"))
            continue
        helped = {**trial.run, "settings": (*trial.run.get("settings", ()), setting)}
        name = f"{trial.name}+{setting.partition('.')[0]}"
        found += [
            replace(trial, expect="break"),
            replace(trial, name=name, run=helped, quick=None),
        ]
    return found
