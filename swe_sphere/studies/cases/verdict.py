"""From measured numbers to verdicts: observed orders, the bounds that hold, and the outcome."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.summary import finite
from swe_sphere.studies.cases.bounds import Check
from swe_sphere.studies.cases.case import ORDERS, Case, Level
from swe_sphere.studies.cases.measure import TIMES, Measure, Tick, measure
from swe_sphere.studies.ended import STOPPED
from swe_sphere.studies.jobs import Tell, in_processes

OUTCOMES = ("passed", "refused", "broke", "failed")


@dataclass(frozen=True, eq=False)
class Row:
    """One level of a case, what was measured, and what it is compared with."""

    case: Case
    level: Level
    measure: Measure
    before: Row | None = None
    """The level before it, None for the first."""

    @cached_property
    def quantities(self) -> dict[str, float]:
        """All numbers, with the observed orders."""
        numbers = self.measure.numbers.items()
        return self.orders | {name: math.nan if x is None else x for name, x in numbers}

    @property
    def orders(self) -> dict[str, float]:
        """Observed orders since the level before, by the names in `ORDERS`; none for the first."""
        if self.before is None:
            return {}
        ratio = math.log(self.fineness / self.before.fineness)
        old, new = self.before.measure.numbers, self.measure.numbers
        return {
            order: math.log(abs(a / b)) / ratio
            for name, order in ORDERS.items()
            if (a := old.get(name)) and (b := new.get(name))
        }

    @property
    def fineness(self) -> float:
        """ne, np - 1 or one over the time step: what the levels of the case differ in."""
        config, along = self.config, self.case.along
        if along == "dt":
            return 1.0 / self.dt
        return float((config.ne or 0) if along == "ne" else (config.np or 0) - 1)

    @property
    def config(self) -> RunConfig:
        """Settings of the run."""
        return self.case.at(self.level).config

    @property
    def dt(self) -> float:
        """Time step [s]."""
        return self.measure.numbers.get("dt") or math.nan

    @property
    def seconds(self) -> float:
        """Wall time of the steps alone [s]."""
        return self.measure.numbers.get("step_seconds") or 0.0

    @cached_property
    def checks(self) -> list[Check]:
        """Every bound of the level; a quantity that was not measured fails it."""
        skipped = set(ORDERS.values()) if self.before is None else set()
        found = [
            (bound, self.quantities.get(bound.quantity, math.nan))
            for bound in self.case.all_bounds(self.level)
            if bound.quantity not in skipped
        ]
        # an upper bound alone limits the size
        return [Check(bound, abs(x) if math.isinf(bound.low) else x) for bound, x in found]

    @cached_property
    def verdict(self) -> tuple[str, list[str]]:
        """The outcome, one of `OUTCOMES`, and the reasons why it is not another one."""
        status, reason, expect = self.measure.status, self.measure.reason, self.case.expect
        if status != "completed" and not self.stopped:
            return "failed", [f"{status}: {reason}"]
        if not self.stopped and expect == "refuse":
            return "failed", ["it was to be refused, but ran to its end"]
        reasons = [str(check) for check in self.broken]
        if reasons or (self.stopped and expect == "pass"):
            return ("broke" if expect == "break" else "failed"), [*reasons, reason]
        return ("refused" if self.stopped else "passed"), [reason]

    @property
    def broken(self) -> list[Check]:
        """Checks that count and do not hold; of a run that stopped itself few count."""
        return [
            check
            for check in self.checks
            if (check.bound.always or not self.stopped) and not check.holds
        ]

    @property
    def outcome(self) -> str:
        """One of `OUTCOMES`."""
        return self.verdict[0]

    @property
    def reason(self) -> str:
        """Why the outcome is not another one; empty for a run within its bounds."""
        return "; ".join(filter(None, self.verdict[1]))

    @property
    def passed(self) -> bool:
        """Whether the run got to its end within all its bounds."""
        return self.outcome == "passed"

    @property
    def stopped(self) -> bool:
        """Whether the run stopped itself with a reason."""
        return self.measure.status in STOPPED

    @property
    def worst(self) -> Check:
        """The check that uses most of its bound."""
        return max(self.checks, key=lambda check: check.used)

    def as_dict(self) -> dict[str, object]:
        """Return all of it in plain numbers and words; None for what is not finite."""
        config = self.config
        return {
            "case": self.case.name,
            "scene": self.case.scene,
            "title": self.case.title,
            "ne": config.ne,
            "np": config.np,
            "dt": finite(self.dt),
            "days": 0.0 if self.case.method == "start" else config.days,
            "stepper": config.stepper,
            "seconds": self.seconds,
            "status": self.measure.status,
            "reason": self.measure.reason or None,
            "quantities": {n: finite(x) for n, x in self.quantities.items() if n not in TIMES},
            "checks": [_plain(check) for check in self.checks],
            "published": [
                {"quantity": quantity, "value": value, "source": published.source}
                for published in self.level.published
                for quantity, value in published.values.items()
            ],
            "passed": self.passed,
        }

    def as_result(self) -> dict[str, object]:
        """Return the measure, the outcome and the bounds in words; None for what is not finite."""
        numbers = {n: None if x is None else finite(x) for n, x in self.measure.numbers.items()}
        return self.measure.model_dump() | {
            "numbers": numbers,
            "reason": self.reason,
            "stepper": self.case.stepper,
            "outcome": self.outcome,
            "bounds": [str(check.bound) for check in self.checks],
        }


def run_cases(
    cases: Sequence[Case],
    known: Mapping[str, Measure] | None = None,
    keep: Callable[[Measure], Measure] | None = None,
    jobs: int = 1,
    tick: Tick | None = None,
) -> Iterator[Row]:
    """Run the levels of the cases and yield their rows in order.

    Args:
        cases: What to run.
        known: Measures by fingerprint that are not made again.
        keep: Stores a new measure and returns it as it will be read again.
        jobs: Number of processes; with several, levels that are not timed are measured first.
        tick: Called with the progress in words.
    """
    found = dict(known or {})
    keep = keep or (lambda measured: measured)
    beside = measured_beside(jobs, cases, found) if jobs > 1 else ()
    for count, measured in enumerate(beside, 1):
        found[measured.fingerprint] = keep(measured)
        if tick is not None:
            tick(f"{count} measured")
    for case in cases:
        before = None
        told = None if tick is None else partial(_of_case, tick, case.name)
        for level in case.levels:
            measured = found.get(case.fingerprint(level)) or keep(measure(case, level, told))
            before = Row(case, level, measured, before)
            yield before


def _of_case(tick: Tick, name: str, text: str) -> None:
    tick(f"{name}: {text}")


def measured_beside(
    jobs: int, cases: Sequence[Case], known: Mapping[str, Measure] | None = None
) -> Iterator[Measure]:
    """Measure levels that are not known in processes beside each other, but none that is timed.

    Raises as `in_processes`.
    """
    tasks: list[tuple[Case, list[Level]]] = []
    for case in (case for case in cases if not case.is_timed):
        left = [level for level in case.levels if case.fingerprint(level) not in (known or {})]
        shared = isinstance(case.against, dict) and left  # one finer run for all of them
        tasks += [(case, left)] if shared else [(case, [level]) for level in left]
    yield from in_processes(jobs, _measuring, (), tasks)


def _measuring(tell: Tell) -> Callable[[tuple[Case, list[Level]]], None]:
    def work(task: tuple[Case, list[Level]]) -> None:
        case, levels = task
        for level in levels:
            tell(measure(case, level))

    return work


def _plain(check: Check) -> dict[str, object]:
    bound = check.bound
    numbers = {"obtained": check.obtained, "low": bound.low, "high": bound.high}
    plain = {name: finite(x) for name, x in numbers.items()}
    return {"quantity": check.quantity, **plain, "passed": check.holds}
