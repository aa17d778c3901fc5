"""The settings that a plan asks for: steppers with their preconditioners, and their steps."""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from swe_sphere.errors import ConfigError
from swe_sphere.planet import DAY
from swe_sphere.simulation.config import RunConfig
from swe_sphere.studies.sweep.bench import Bench
from swe_sphere.studies.sweep.case import Case, Schedule, free_steps
from swe_sphere.studies.sweep.ladder import ladder
from swe_sphere.studies.sweep.plan import SweepPlan

if TYPE_CHECKING:
    from swe_sphere.steppers import Stepper

__all__ = ["Contender", "contenders"]


@dataclass(frozen=True)
class Contender:
    """A stepper with its options on a bench: everything of a run but its step."""

    bench: Bench
    config: RunConfig
    schedule: Schedule
    judges: tuple[str, ...]

    @property
    def kind(self) -> type[Stepper]:
        """The class of the stepper."""
        return _kind(self.config.stepper)

    @property
    def label(self) -> str:
        """The contender in words."""
        with_ = f" {self.config.preconditioner}" if self.config.preconditioner else ""
        return f"{self.config.stepper}{with_}, {self.bench.label}"

    @property
    def refusal(self) -> str | None:
        """Why the stepper cannot run this scene, if it cannot."""
        try:
            self.bench.options(self.config)
            _ = self.stable_dt
        except ConfigError as error:
            return " ".join(str(error).split())
        return None

    @property
    def stable_dt(self) -> float:
        """Stability limit at the start [s], about; infinite where there is none."""
        return self.bench.stable_dt(self.kind)

    @property
    def usable_dt(self) -> float:
        """The part of it that can be used when winds grow [s]."""
        return self.kind.safety * self.stable_dt

    def ladder(self, levels: int) -> list[float]:
        """Steps to try [s], the longest first."""
        explicit = math.isfinite(self.stable_dt) and self.kind.family == "explicit"
        gravity = self.bench.limits.gravity
        return ladder(self.usable_dt, explicit, gravity, self.schedule.interval, levels)

    def case(self, dt: float, role: str = "grid") -> Case:
        """The run with steps of dt [s], a little shorter where report times ask for it."""
        try:
            steps, refusal = self.schedule.steps(dt), self.refusal
        except ConfigError as error:
            steps, refusal = None, str(error)
        return Case(
            self.bench, self.config, self.schedule, steps, role,
            judges=self.judges, refusal=refusal, wanted=dt,
        )  # fmt: skip

    def trial(self, dt: float) -> Case:
        """A run with steps of exactly dt [s], only to see whether it gets to the end."""
        steps = free_steps(self.schedule.days, dt)
        return Case(self.bench, self.config, self.schedule, steps, "stability", judged=False)

    def cases(self, plan: SweepPlan) -> list[Case]:
        """The runs of a grid, without those that are the same after all."""
        if plan.dt != "auto":
            steps = list(plan.dt)
        elif self.refusal is None:
            steps = self.ladder(plan.levels)
        else:
            steps = [self.schedule.interval]
        found = {case.key: case for case in map(self.case, steps)}
        return list(found.values())

    @property
    def longest(self) -> float:
        """The longest step that is worth a trial [s]."""
        return min(self.schedule.interval, 0.5 * self.schedule.days * DAY)


def contenders(
    plan: SweepPlan, benches: list[Bench], schedule: Schedule, judges: tuple[str, ...]
) -> list[Contender]:
    """All of them, mesh by mesh."""
    return [
        Contender(bench, config, schedule, judges)
        for bench in benches
        for config in _configs(plan, bench)
    ]


def _configs(plan: SweepPlan, bench: Bench) -> Iterator[RunConfig]:
    """Steppers with each preconditioner; those that take none come once, and without tolerance."""
    for stepper in plan.steppers:
        takes = inspect.signature(_kind(stepper)).parameters
        names = plan.preconditioner if "preconditioner" in takes else ()
        for name in names or (None,):
            chosen: dict[str, object] = {"stepper": stepper, "preconditioner": name}
            if "tolerance" in takes:
                chosen["tolerance"] = plan.tolerance
            yield bench.config.model_copy(update=chosen)


def _kind(name: str) -> type[Stepper]:
    from swe_sphere.steppers import get_stepper

    return get_stepper(name)
