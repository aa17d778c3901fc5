"""The runs of a sweep: their settings and keys, and those that a stepper on a mesh asks for."""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property, reduce
from typing import TYPE_CHECKING, Literal

from swe_sphere.errors import ConfigError
from swe_sphere.fingerprints import fingerprint
from swe_sphere.planet import DAY
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.time_plan import TimePlan, common_measure, time_plan
from swe_sphere.studies.sweep.discretisation import Discretisation
from swe_sphere.studies.sweep.steps import dt_sequence
from swe_sphere.studies.sweep.sweep_plan import SweepPlan
from swe_sphere.studies.sweep.users_code import users_methods
from swe_sphere.user_file import is_user_file

if TYPE_CHECKING:
    from swe_sphere.steppers import Stepper

__all__ = ["Integrator", "Role", "RunSpec", "Schedule", "free_steps", "integrators"]


Role = Literal["grid", "target", "stability", "converged"]
"""What a run is made for: a grid, a search for an error or for the longest stable step, or to be
compared with."""


@dataclass(frozen=True)
class Schedule:
    """Length of the runs and times at which their errors are taken [days]; the last is the end."""

    days: float
    report_days: tuple[float, ...]

    @classmethod
    def of(cls, days: float, report_days: tuple[float, ...]) -> Schedule:
        """The schedule with the end among its report days."""
        return cls(days, tuple(sorted({*report_days, days})))

    @cached_property
    def interval(self) -> float:
        """The longest time [s] of which all report times are multiples, to the millisecond."""
        times = [Fraction(day * DAY).limit_denominator(1000) for day in self.report_days]
        return float(reduce(common_measure, times))

    def steps(self, dt: float) -> TimePlan:
        """Steps of at most dt [s] that meet all report times.

        Raises:
            ConfigError: no step near dt does.
        """
        return time_plan(self.days, self.interval / 3600.0, dt)


def free_steps(days: float, dt: float) -> TimePlan:
    """Steps of exactly dt [s] to the end or a little beyond, for runs that meet no report times."""
    count = max(1, math.ceil(days * DAY / dt - 1e-9))
    return TimePlan(dt, count, count, dt)


@dataclass(frozen=True)
class RunSpec:
    """The settings of one run: plain values, but for the discretisation, which they name as well.

    Two are equal where they ask for the same.
    """

    space: Discretisation = field(compare=False, repr=False)
    config: RunConfig
    """Complete: mesh, precision, stepper and its options, the step dt [s] and the length."""
    steps: TimePlan | None = field(compare=False)
    """None where no step near the one wanted is possible."""
    role: Role = "grid"
    report_days: tuple[float, ...] = ()
    """When errors are taken; none where the run is only to show whether it gets to the end."""
    references: tuple[str, ...] = ()
    """What its errors are taken against."""
    refusal: str | None = None
    """Why it cannot be run, where that is known beforehand."""

    @property
    def dt(self) -> float:
        """The step [s]."""
        return float(self.config.dt)

    @property
    def label(self) -> str:
        """The setting in words."""
        with_ = f" {self.config.preconditioner}" if self.config.preconditioner else ""
        return f"{self.config.stepper}{with_}, {self.space.label}, dt {self.dt:.5g} s"

    @property
    def integrator(self) -> tuple[object, ...]:
        """The same for all runs that differ in their step at most."""
        return (self.space.identity, self.config.stepper, self.config.preconditioner)

    @cached_property
    def key(self) -> str:
        """Name of all settings, files and code that matter for the result."""
        return fingerprint([
            self.space.identity, self.config.stepper, self._options, repr(self.dt),
            self.config.days, self.report_days, self.references, self.sources,
        ])  # fmt: skip

    @cached_property
    def _options(self) -> dict[str, object]:
        """What the stepper is built with; as asked for where it takes no such options."""
        try:
            return self.space.options(self.config)
        except ConfigError:
            return {"preconditioner": self.config.preconditioner}

    @cached_property
    def sources(self) -> dict[str, str]:
        """Fingerprints of the stepper and the preconditioner, where they are the user's own."""
        chosen = self.config.preconditioner
        return users_methods([self.config.stepper], [chosen] if chosen else [])

    @property
    def resolved(self) -> RunConfig:
        """The configuration with the stepper of a file by name, and with its preconditioner."""
        from swe_sphere.steppers import get_stepper

        stepper, chosen = self.config.stepper, self._options.get("preconditioner")
        named = get_stepper(stepper).name if is_user_file(stepper) else stepper
        asked = self.config.preconditioner if self.refusal or not chosen else chosen
        return self.config.model_copy(update={"stepper": named, "preconditioner": asked})

    def report_steps(self) -> dict[int, float]:
        """The report days by the steps after which they come."""
        return {round(day * DAY / self.dt): day for day in self.report_days}


@dataclass(frozen=True)
class Integrator:
    """Everything of a run but its step."""

    space: Discretisation
    config: RunConfig
    schedule: Schedule
    references: tuple[str, ...]

    @property
    def kind(self) -> type[Stepper]:
        """The class of the stepper."""
        from swe_sphere.steppers import get_stepper

        return get_stepper(self.config.stepper)

    @property
    def label(self) -> str:
        """The stepper and its discretisation in words."""
        with_ = f" {self.config.preconditioner}" if self.config.preconditioner else ""
        return f"{self.config.stepper}{with_}, {self.space.label}"

    @cached_property
    def refusal(self) -> str | None:
        """Why the stepper cannot run this scene, if it cannot."""
        try:
            self.space.options(self.config)
            _ = self.stable_dt
        except ConfigError as error:
            return " ".join(str(error).split())
        return None

    @property
    def stable_dt(self) -> float:
        """Stability limit at the start [s], about; infinite where there is none."""
        return self.space.stable_dt(self.kind)

    @property
    def longest(self) -> float:
        """The longest step that is worth a trial [s]."""
        return min(self.schedule.interval, 0.5 * self.schedule.days * DAY)

    def dt_sequence(self, levels: int) -> list[float]:
        """Steps to try [s], the longest first."""
        explicit = math.isfinite(self.stable_dt) and self.kind.family == "explicit"
        usable, gravity = self.kind.safety * self.stable_dt, self.space.gravity_limit
        return dt_sequence(usable, explicit, gravity, self.schedule.interval, levels)

    def run(self, dt: float, role: Role = "grid") -> RunSpec:
        """The run with steps of dt [s], a little shorter where report times ask for it."""
        try:
            steps, refusal = self.schedule.steps(dt), self.refusal
        except ConfigError as error:
            steps, refusal = None, str(error)
        config = self._config(dt if steps is None else steps.dt)
        days, references = self.schedule.report_days, self.references
        return RunSpec(self.space, config, steps, role, days, references, refusal)

    def trial(self, dt: float) -> RunSpec:
        """A run with steps of exactly dt [s], only to see whether it gets to the end."""
        steps = free_steps(self.schedule.days, dt)
        return RunSpec(self.space, self._config(dt), steps, "stability")

    def grid(self, plan: SweepPlan) -> list[RunSpec]:
        """The runs that a plan asks for, without those that are the same after all."""
        if plan.dt != "auto":
            steps = list(plan.dt)
        elif self.refusal is None:
            steps = self.dt_sequence(plan.levels)
        else:
            steps = [self.schedule.interval]
        return [*dict.fromkeys(map(self.run, steps))]

    def _config(self, dt: float) -> RunConfig:
        return self.config.model_copy(update={"dt": dt, "days": self.schedule.days})


def integrators(
    plan: SweepPlan, spaces: list[Discretisation], schedule: Schedule, references: tuple[str, ...]
) -> list[Integrator]:
    """All that a plan asks for, mesh by mesh."""
    return [
        Integrator(space, config, schedule, references)
        for space in spaces
        for config in _configs(plan, space)
    ]


def _configs(plan: SweepPlan, space: Discretisation) -> Iterator[RunConfig]:
    """Steppers with each preconditioner; those that take none come once, and without tolerance."""
    from swe_sphere.steppers import get_stepper

    for stepper in plan.steppers:
        takes = inspect.signature(get_stepper(stepper)).parameters
        names = plan.preconditioner if "preconditioner" in takes else ()
        for name in names or (None,):
            chosen: dict[str, object] = {"stepper": stepper, "preconditioner": name}
            if "tolerance" in takes:
                chosen["tolerance"] = plan.tolerance
            yield space.config.model_copy(update=chosen)
