"""One run of a sweep: its settings, and the key under which its record is found again."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property, reduce

from swe_sphere.errors import ConfigError
from swe_sphere.fingerprints import fingerprint
from swe_sphere.planet import DAY
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.plan import TimePlan, time_plan
from swe_sphere.studies.sweep.bench import Bench

__all__ = ["Case", "Schedule", "free_steps"]


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
        return float(reduce(_common_measure, times))

    def steps(self, dt: float) -> TimePlan:
        """Steps of at most dt [s] that meet all report times.

        Raises:
            ConfigError: no step near dt does.
        """
        return time_plan(self.days, self.interval / 3600.0, dt)

    def report_steps(self, plan: TimePlan) -> dict[int, float]:
        """The report days by the steps after which they come."""
        return {round(day * DAY / plan.dt): day for day in self.report_days}


def free_steps(days: float, dt: float) -> TimePlan:
    """Steps of exactly dt [s] to the end or a little beyond, for runs that meet no report times."""
    count = max(1, math.ceil(days * DAY / dt - 1e-9))
    return TimePlan(dt, count, count, dt)


def _common_measure(a: Fraction, b: Fraction) -> Fraction:
    numerator = math.gcd(a.numerator * b.denominator, b.numerator * a.denominator)
    return Fraction(numerator, a.denominator * b.denominator)


@dataclass(frozen=True)
class Case:
    """A setting to be run."""

    bench: Bench
    config: RunConfig
    """With stepper and options, but without dt."""
    schedule: Schedule
    steps: TimePlan | None
    """None where no step near the one wanted is possible."""
    role: str = "grid"
    judged: bool = True
    """Whether errors are taken; else the run is only to show whether it gets to the end."""
    judges: tuple[str, ...] = ()
    """What its errors are taken against."""
    refusal: str | None = None
    """Why it cannot be run, where that is known beforehand."""
    wanted: float = field(default=0.0)
    """The step asked for [s]."""

    @property
    def dt(self) -> float:
        """The step [s]."""
        return self.wanted if self.steps is None else self.steps.dt

    @property
    def label(self) -> str:
        """The setting in words."""
        with_ = f" {self.config.preconditioner}" if self.config.preconditioner else ""
        return f"{self.config.stepper}{with_}, {self.bench.label}, dt {self.dt:.5g} s"

    @cached_property
    def key(self) -> str:
        """Name of all settings that matter for the result."""
        return fingerprint([
            self.bench.token, self.config.stepper, self._options(), repr(self.dt),
            self.schedule.days, self.schedule.report_days if self.judged else None,
            self.judges if self.judged else None,
        ])  # fmt: skip

    def _options(self) -> dict[str, object]:
        try:
            return self.bench.options(self.config)
        except ConfigError:
            return {"preconditioner": self.config.preconditioner}
