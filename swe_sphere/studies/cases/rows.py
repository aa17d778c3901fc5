"""From measured numbers to verdicts: observed orders, the bounds that hold, and the outcome."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, groupby

from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.summary import finite
from swe_sphere.studies.cases.case import ORDERS, Case, Check
from swe_sphere.studies.cases.measure import TIMES, Measure, Tick, measure
from swe_sphere.studies.ended import STOPPED
from swe_sphere.studies.jobs import in_processes
from swe_sphere.studies.record_store import Store

OUTCOMES = ("passed", "refused", "broke", "failed")


@dataclass(frozen=True, eq=False)
class Row:
    """A case, what was measured, and what it is compared with."""

    case: Case
    measure: Measure
    before: Row | None = None
    """The case of the same name before it, None for the first."""

    @cached_property
    def quantities(self) -> dict[str, float]:
        """All numbers, and the observed orders since the row before by the names in `ORDERS`."""
        numbers = {n: math.nan if x is None else x for n, x in self.measure.numbers.items()}
        if self.before is None or self.before._fineness == self._fineness:
            return numbers
        ratio = math.log(self._fineness / self.before._fineness)
        old, new = self.before.measure.numbers, self.measure.numbers
        orders = {
            order: math.log(abs(a / b)) / ratio
            for name, order in ORDERS.items()
            if (a := old.get(name)) and (b := new.get(name))
        }
        return orders | numbers

    @property
    def _fineness(self) -> float:
        """ne, np - 1 or one over the time step: the quantity in which rows of a name differ."""
        ne, np = self.config.ne or 0, self.config.np or 0
        return {"ne": ne, "np": np - 1, "dt": 1.0 / self.dt}[self.case.along]

    @property
    def config(self) -> RunConfig:
        """Settings of the run."""
        return self.case.configured()

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
        """Every bound of the case; a quantity that was not measured fails it."""
        checks = self.case.checks
        if self.before is None:
            checks = [check for check in checks if check.quantity not in ORDERS.values()]
        found = [(check, self.quantities.get(check.quantity, math.nan)) for check in checks]
        # an upper bound alone limits the size
        return [replace(of, obtained=abs(x) if math.isinf(of.low) else x) for of, x in found]

    @property
    def used(self) -> float:
        """Largest fraction of a bound that is used, see `Check.used`."""
        return max((check.used for check in self.checks), default=0.0)

    @cached_property
    def _verdict(self) -> tuple[str, list[str]]:
        """The outcome, one of `OUTCOMES`, and the reasons why it is not another one."""
        status, reason, expect = self.measure.status, self.measure.reason, self.case.expect
        stopped = status in STOPPED
        if status != "completed" and not stopped:
            return "failed", [f"{status}: {reason}"]
        if not stopped and expect == "refuse":
            return "failed", ["it was to be refused, but ran to its end"]
        counted = (check for check in self.checks if check.always or not stopped)
        reasons = [str(check) for check in counted if not check.holds]
        if reasons or (stopped and expect == "pass"):
            return ("broke" if expect == "break" else "failed"), [*reasons, reason]
        return ("refused" if stopped else "passed"), [reason]

    @property
    def outcome(self) -> str:
        """One of `OUTCOMES`."""
        return self._verdict[0]

    @property
    def reason(self) -> str:
        """Why the outcome is not another one; empty for a run within its bounds."""
        return "; ".join(filter(None, self._verdict[1]))

    @property
    def passed(self) -> bool:
        """Whether the run got to its end within all its bounds."""
        return self.outcome == "passed"

    def as_dict(self) -> dict[str, object]:
        """Return all of it in plain numbers and words; None for what is not finite."""
        config, case = self.config, self.case
        values = {
            "case": case.name, "scene": case.scene, "title": case.title,
            "ne": config.ne, "np": config.np, "dt": self.dt,
            "days": 0.0 if case.method == "start" else config.days,
            "stepper": config.stepper, "seconds": self.seconds,
            "status": self.measure.status, "reason": self.measure.reason or None,
            "quantities": {n: x for n, x in self.quantities.items() if n not in TIMES},
            "checks": [
                {
                    "quantity": check.quantity, "obtained": check.obtained,
                    "low": check.low, "high": check.high, "passed": check.holds,
                }
                for check in self.checks
            ],
            "published": [
                {"quantity": quantity, "value": value, "source": source}
                for source, values in self.case.published.items()
                for quantity, value in values.items()
            ],
            "passed": self.passed,
        }  # fmt: skip
        return dict(finite(values))

    def as_result(self) -> dict[str, object]:
        """Return the measure, the outcome and the bounds in words; None for what is not finite."""
        return self.measure.model_dump() | {
            "numbers": finite(self.measure.numbers), "reason": self.reason,
            "stopped": self.measure.reason, "stepper": self.case.stepper, "outcome": self.outcome,
            "bounds": [check.limits for check in self.checks],
        }  # fmt: skip


def count_outcomes(rows: Iterable[Row]) -> dict[str, int]:
    """Return how many of the rows had each of the `OUTCOMES`."""
    counts = Counter(row.outcome for row in rows)
    return {name: counts[name] for name in OUTCOMES}


def run_cases(
    cases: Sequence[Case],
    known: Iterable[Measure] = (),
    store: Store[Measure] | None = None,
    jobs: int = 1,
    tick: Tick | None = None,
) -> Iterator[Row]:
    """Run the cases and yield their rows in order.

    Args:
        cases: What to run.
        known: Measures that are not made again.
        store: Where new measures are kept.
        jobs: Number of processes; with several, cases that are not timed are measured first.
        tick: Called with the progress in words.
    """
    found = {each.fingerprint: each for each in known}
    keep = store.add if store else (lambda measured: measured)
    beside = measured_beside(jobs, cases, found) if jobs > 1 else ()
    for count, measured in enumerate(beside, 1):
        found[measured.fingerprint] = keep(measured)
        if tick is not None:
            tick(f"{count} measured")
    before = None
    for case in cases:
        measured = found.get(case.fingerprint) or keep(measure(case, tick))
        follows = before is not None and before.case.name == case.name
        before = Row(case, measured, before if follows else None)
        yield before


def measured_beside(
    jobs: int, cases: Sequence[Case], known: Collection[str] = ()
) -> Iterator[Measure]:
    """Measure cases in processes beside each other, those of a name in one, but none that is timed.

    known: Fingerprints of cases that are not measured.  Raises as `in_processes`.
    """
    left = [case for case in cases if not case.is_timed and case.fingerprint not in known]
    tasks = [[*group] for _, group in groupby(left, lambda case: case.name)]
    yield from chain.from_iterable(in_processes(jobs, _measuring, tasks))


def _measuring() -> Callable[[list[Case]], list[Measure]]:
    return lambda task: [measure(case) for case in task]
