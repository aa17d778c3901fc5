"""The runs of a sweep: settings, keys, those of a stepper on a mesh, what can be made beside."""

from __future__ import annotations

import inspect
import math
import sys
import uuid
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

from swe_sphere.errors import ConfigError, in_one_line
from swe_sphere.files.fingerprints import file_fingerprint, fingerprint
from swe_sphere.files.user_file import is_user_file
from swe_sphere.planet import DAY
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.time_plan import TimePlan, free_steps, stepper_options
from swe_sphere.solvers.preconditioners import PRECONDITIONERS
from swe_sphere.steppers import STEPPERS, Stepper, get_stepper
from swe_sphere.studies.sweep.discretisation import Discretisation, Discretisations, Schedule
from swe_sphere.studies.sweep.steps import dt_sequence, halved
from swe_sphere.studies.sweep.sweep_plan import SweepPlan

SESSION = uuid.uuid4().hex
"""In the place of the fingerprint of code that is in no file: nothing of it is known later."""


Role = Literal["grid", "target", "stability", "converged"]
"""What a run is made for: a grid, a search for an error or for the longest stable step, or to be
compared with."""


@dataclass(frozen=True)
class Integrator:
    """Everything of a run but its step; two are equal where they ask for the same."""

    space: Discretisation = field(compare=False, repr=False)
    config: RunConfig
    """Mesh, precision, stepper and its options."""
    schedule: Schedule
    references: tuple[str, ...] = ()
    """What errors are taken against."""

    @property
    def kind(self) -> type[Stepper]:
        """The class of the stepper."""
        return get_stepper(self.config.stepper)

    @property
    def label(self) -> str:
        """The stepper and its discretisation in words."""
        with_ = f" {self.config.preconditioner}" if self.config.preconditioner else ""
        return f"{self.config.stepper}{with_}, {self.space.label}"

    @property
    def identity(self) -> tuple[object, ...]:
        """The same for all that compile and do the same."""
        return (self.space.identity, self.config.stepper, self.config.preconditioner)

    @cached_property
    def refusal(self) -> str | None:
        """Why the stepper cannot run this scene, if it cannot."""
        try:
            stepper_options(self.kind, self.config)
            _ = self.stable_dt
        except ConfigError as error:
            return in_one_line(error)
        return None

    @cached_property
    def options(self) -> dict[str, object]:
        """What the stepper is built with; as asked for where it cannot be."""
        if self.refusal is not None:
            return {"preconditioner": self.config.preconditioner}
        return stepper_options(self.kind, self.config)

    @cached_property
    def sources(self) -> dict[str, str]:
        """Fingerprints of the stepper and the preconditioner, where they are the user's own."""
        chosen = self.config.preconditioner
        return users_methods([self.config.stepper], [chosen] if chosen else [])

    @property
    def stable_dt(self) -> float:
        """Stability limit at the start [s], about; infinite where there is none."""
        return self.space.stable_dt(self.kind)

    @property
    def longest(self) -> float:
        """The longest step that is worth a trial [s]."""
        return min(self.schedule.interval, 0.5 * self.schedule.days * DAY)

    def dt_sequence(self, levels: int, longest: float | None = None) -> list[float]:
        """Steps to try [s], the longest first; longest: none is longer [s], and they are halved."""
        explicit = math.isfinite(self.stable_dt) and self.kind.family == "explicit"
        usable, gravity = self.kind.safety * self.stable_dt, self.space.gravity_limit
        if longest is not None:
            return halved(min(usable, longest, self.schedule.interval), 0.25 * gravity, levels)
        return dt_sequence(usable, explicit, gravity, self.schedule.interval, levels)

    def run(self, dt: float, role: Role = "grid") -> RunSpec:
        """The run with steps of dt [s], a little shorter where report times ask for it."""
        try:
            return self.planned(self.schedule.steps(dt), role)
        except ConfigError as error:
            return RunSpec(self, dt, None, role, str(error))

    def planned(self, steps: TimePlan, role: Role) -> RunSpec:
        """The run with just these steps."""
        return RunSpec(self, steps.dt, steps, role, self.refusal)

    def trial(self, dt: float) -> RunSpec:
        """A run with steps of exactly dt [s], only to see whether it gets to the end."""
        alone = replace(self, schedule=Schedule(self.schedule.days, ()), references=())
        return alone.planned(free_steps(self.schedule.days, dt), "stability")

    def grid(self, plan: SweepPlan) -> list[RunSpec]:
        """The runs that a plan asks for, without those that are the same after all."""
        if plan.dt != "auto":
            steps = list(plan.dt)
        elif self.refusal is None:
            steps = self.dt_sequence(plan.levels, plan.longest)
        else:
            steps = [self.schedule.interval]
        return [*dict.fromkeys(map(self.run, steps))]


@dataclass(frozen=True)
class RunSpec:
    """One run; two are equal where they ask for the same."""

    integrator: Integrator
    dt: float
    """The step [s]."""
    steps: TimePlan | None = field(compare=False)
    """None where no step near the one wanted is possible."""
    role: Role = "grid"
    refusal: str | None = field(default=None, compare=False)
    """Why it cannot be run, where that is known beforehand."""

    @property
    def space(self) -> Discretisation:
        """The scene on its mesh."""
        return self.integrator.space

    @property
    def label(self) -> str:
        """The setting in words."""
        return f"{self.integrator.label}, dt {self.dt:.5g} s"

    @cached_property
    def config(self) -> RunConfig:
        """The configuration, complete: with the step and the length."""
        changes = {"dt": self.dt, "days": self.integrator.schedule.days}
        return self.integrator.config.model_copy(update=changes)

    @cached_property
    def key(self) -> str:
        """Name of all settings, files and code that matter for the result."""
        of = self.integrator
        return fingerprint([
            of.space.identity, of.config.stepper, of.options, repr(self.dt), of.schedule.days,
            of.schedule.report_days, of.references, of.sources,
        ])  # fmt: skip

    @property
    def resolved(self) -> RunConfig:
        """The configuration with the stepper of a file by name, and with its preconditioner."""
        stepper, kind = self.config.stepper, self.integrator.kind
        chosen = self.integrator.options.get("preconditioner") or self.config.preconditioner
        named = kind.name if is_user_file(stepper) else stepper
        return self.config.model_copy(update={"stepper": named, "preconditioner": chosen})

    def report_steps(self) -> dict[int, float]:
        """The report days by the steps after which they come."""
        return {round(day * DAY / self.dt): day for day in self.integrator.schedule.report_days}


def integrators(spaces: Discretisations, references: tuple[str, ...]) -> list[Integrator]:
    """All that a plan asks for, mesh by mesh."""
    return [
        Integrator(space, config, spaces.schedule, references)
        for space in spaces.all()
        for config in _configs(spaces.plan, space)
    ]


def _configs(plan: SweepPlan, space: Discretisation) -> Iterator[RunConfig]:
    """Steppers with each preconditioner; those that take none come once, and without tolerance."""
    for stepper in plan.steppers:
        takes = inspect.signature(get_stepper(stepper)).parameters
        names = plan.preconditioner if "preconditioner" in takes else ()
        for name in names or (None,):
            chosen: dict[str, object] = {"stepper": stepper, "preconditioner": name}
            if "tolerance" in takes:
                chosen["tolerance"] = plan.tolerance
            yield space.config.model_copy(update=chosen)


def users_methods(steppers: Iterable[str], preconditioners: Iterable[str]) -> dict[str, str]:
    """Fingerprints of those that are no part of the package, by what they are.

    steppers, preconditioners: names, or files.  Raises ConfigError where there is none of a name.
    """
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


@dataclass(frozen=True)
class Part:
    """Runs of an integrator, by its number, that one process makes one after the other."""

    what: Literal["grid", "search", "limit"]
    integrator: int
    first: int = 0
    last: int | None = None
    """Which of its grid, the last excluded."""


def parts_of(plan: SweepPlan, everyone: Sequence[Integrator]) -> list[Part]:
    """All parts; the shortest steps come first, so that nobody is left with them at the end."""
    found: list[Part] = []
    for n, integrator in enumerate(everyone):
        if plan.find_limit:
            found.append(Part("limit", n))
        if plan.target_error is not None:
            found.append(Part("search", n))
        elif plan.enough is not None:  # which runs are needed shows on the way
            found.append(Part("grid", n))
        else:
            found += [Part("grid", n, i, i + 1) for i in range(len(integrator.grid(plan)))]
    return sorted(found, key=lambda part: part.first, reverse=True)
