"""From measured numbers to verdicts: which bounds hold, and the observed order."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial

from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.summary import finite
from swe_sphere.studies.ended import Check
from swe_sphere.studies.jobs import Tell, in_processes
from swe_sphere.studies.record_store import Store
from swe_sphere.studies.verify.case import ORDERS, Case, Level
from swe_sphere.studies.verify.measure import Finer, Measure, completed, measure


@dataclass(frozen=True, eq=False)
class Row:
    """One level of a case: what was measured and what it was held against."""

    case: Case
    level: Level
    measure: Measure
    before: Row | None = None
    """The level run before it, None for the first."""

    @cached_property
    def quantities(self) -> dict[str, float]:
        """All numbers, with `order` of height, `order_v` of wind and `order_energy`."""
        return self.orders | {
            name: math.nan if x is None else x
            for name, x in self.measure.numbers.items()
            if name not in ("dt", "seconds")
        }

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
        """1/ne, 1/(np - 1) or the time step, inverted: what the levels of the case differ in."""
        config, along = self.config, self.case.along
        if along == "dt":
            return 1.0 / self.dt
        return float((config.ne or 0) if along == "ne" else (config.np or 0) - 1)

    @property
    def config(self) -> RunConfig:
        """The run."""
        return self.case.at(self.level).config

    @property
    def dt(self) -> float:
        """Step taken [s]."""
        return self.measure.numbers["dt"] or math.nan

    @property
    def seconds(self) -> float:
        """Wall time of the steps alone [s]."""
        return self.measure.numbers["seconds"] or 0.0

    @property
    def checks(self) -> list[Check]:
        """Every bound of the level; a quantity that was not measured fails it."""
        skipped = set(ORDERS.values()) if self.before is None else set()
        bounds = [b for b in self.case.bounds(self.level) if b.quantity not in skipped]
        found = ((bound, self.quantities.get(bound.quantity, math.nan)) for bound in bounds)
        # an upper bound alone is one of the size
        return [Check(bound, abs(x) if math.isinf(bound.low) else x) for bound, x in found]

    @property
    def passed(self) -> bool:
        """Whether all bounds hold."""
        return all(check.holds for check in self.checks)

    @property
    def stopped(self) -> bool:
        """Whether the run did not get to its end."""
        return self.measure.status != "completed"

    @property
    def worst(self) -> Check:
        """The check that uses most of its bound."""
        return max(self.checks, key=lambda check: check.used)

    def as_dict(self) -> dict[str, object]:
        """All of it in plain numbers and words; None for what is not finite."""
        config = self.config
        return {
            "case": self.case.name,
            "scene": self.case.scene,
            "title": self.case.title,
            "ne": config.ne,
            "np": config.np,
            "dt": finite(self.dt),
            "days": 0.0 if self.case.start else config.days,
            "stepper": config.stepper,
            "seconds": self.seconds,
            "status": self.measure.status,
            "reason": self.measure.reason or None,
            "quantities": {name: finite(x) for name, x in self.quantities.items()},
            "checks": [_told(check) for check in self.checks],
            "published": [
                {"quantity": quantity, "value": value, "source": published.source}
                for published in self.level.published
                for quantity, value in published.values.items()
            ],
            "passed": self.passed,
        }


def run_cases(
    cases: Iterable[Case],
    quick: bool = False,
    runs: Store[Measure] | None = None,
    known: Iterable[Measure] = (),
) -> Iterator[Row]:
    """Run the levels of the cases one by one; quick: only those marked so.

    runs: keeps what is measured; what it has already, and what is known, is not measured again.
    """
    by_key = {run.fingerprint: run for run in (*(runs.records if runs else ()), *known)}
    for case in cases:
        finer, before = _finer(case), None
        for level in _levels(case, quick):
            key = case.fingerprint(level)
            found = by_key.get(key) or measure(case.at(level), finer, case.start, key)
            if runs is not None and key not in by_key:
                found = runs.add(found)
            before = Row(case, level, found, before)
            yield before


def measured_beside(
    jobs: int, cases: Sequence[Case], quick: bool = False, runs: Store[Measure] | None = None
) -> Iterator[Measure]:
    """What levels come to that `runs` does not have, measured in processes beside each other.

    Raises as `in_processes`.
    """
    known = {run.fingerprint for run in runs.records} if runs else set()
    tasks: list[tuple[int, list[Level]]] = []
    for n, case in enumerate(cases):
        left = [level for level in _levels(case, quick) if case.fingerprint(level) not in known]
        shared = isinstance(case.against, dict) and left  # one finer run for all of them
        tasks += [(n, left)] if shared else [(n, [level]) for level in left]
    for found in in_processes(jobs, _measuring, (cases,), tasks):
        yield found if runs is None else runs.add(found)


def _measuring(tell: Tell, cases: Sequence[Case]) -> Callable[[tuple[int, list[Level]]], None]:
    def work(task: tuple[int, list[Level]]) -> None:
        case, finer = cases[task[0]], _finer(cases[task[0]])
        for level in task[1]:
            tell(measure(case.at(level), finer, case.start, case.fingerprint(level)))

    return work


def _levels(case: Case, quick: bool) -> list[Level]:
    return [level for level in case.levels if level.quick or not quick]


def _finer(case: Case) -> str | Finer | None:
    """What a case is compared with; a finer run is made once."""
    against = case.against
    if not isinstance(against, dict):
        return against
    return cache(partial(completed, case.base.changed(against)))


def _told(check: Check) -> dict[str, object]:
    bound = check.bound
    numbers = {"obtained": check.obtained, "low": bound.low, "high": bound.high}
    plain = {name: finite(x) for name, x in numbers.items()}
    return {"quantity": check.quantity, **plain, "passed": check.holds}
