"""From measured numbers to verdicts: which bounds hold, and the observed order."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

from swe_sphere.studies.verify.case import Case, Rung, Setting
from swe_sphere.studies.verify.measure import Finer, Measure, measure

__all__ = ["NORMS", "ORDERS", "Check", "Row", "verify"]

NORMS = tuple(f"{norm}_{name}" for name in "hv" for norm in ("l1", "l2", "linf"))
"""The names of the six normalised errors."""

ORDERS = {
    "l2_h": "order",
    "l2_v": "order_v",
    "energy_drift": "order_energy",
    "l2_q_gaussian_hills": "order_q",
}
"""What falls with resolution, and the name of its order."""


@dataclass(frozen=True)
class Check:
    """One number and its bounds."""

    quantity: str
    obtained: float
    low: float = -math.inf
    high: float = math.inf

    @property
    def passed(self) -> bool:
        """Whether the number is within its bounds; what is no number is not."""
        return self.low <= self.obtained <= self.high

    @property
    def used(self) -> float:
        """Part of the bound that is used: 1 is just within; inf for what is no number."""
        x, low, high = self.obtained, self.low, self.high
        if not math.isfinite(x):
            return math.inf
        if math.isinf(low):
            return x / high
        if math.isinf(high):
            return low / x if x > 0.0 else math.inf
        return abs(2.0 * x - low - high) / (high - low)


@dataclass(frozen=True)
class Row:
    """One rung of a case: what was measured and what it was held against."""

    case: Case
    rung: Rung
    setting: Setting
    measure: Measure
    order: dict[str, float] | None = None
    """Observed order of what falls with resolution, since the rung before; None for the first."""

    @property
    def quantities(self) -> dict[str, float]:
        """All numbers, with `order` of height, `order_v` of wind and `order_energy`."""
        orders = {ORDERS[name]: x for name, x in (self.order or {}).items()}
        return self.measure.quantities | orders

    @property
    def checks(self) -> list[Check]:
        """Every bound of the rung; a quantity that was not measured fails it."""
        return list(self._checks())

    @property
    def passed(self) -> bool:
        """Whether all bounds hold."""
        return all(check.passed for check in self.checks)

    @property
    def used(self) -> float:
        """Part of the tightest bound that is used."""
        return max((check.used for check in self.checks), default=0.0)

    def as_dict(self) -> dict[str, object]:
        """All of it in plain numbers and words; None for what is not finite."""
        return {
            "case": self.case.name,
            "scene": self.case.scene,
            "title": self.case.title,
            "ne": self.setting.ne,
            "np": self.setting.np,
            "dt": self.measure.dt,
            "days": self.setting.days,
            "stepper": self.setting.stepper,
            "seconds": self.measure.seconds,
            "quantities": {name: _plain(x) for name, x in self.quantities.items()},
            "checks": [
                {key: _plain(value) for key, value in asdict(check).items()}
                | {"passed": check.passed}
                for check in self.checks
            ],
            "figures": [asdict(figure) for figure in self.rung.figures],
            "passed": self.passed,
        }

    def _checks(self) -> Iterator[Check]:
        rung, tolerance = self.rung, self.case.tolerance
        for name, bound in rung.upper().items():
            yield Check(name, abs(self._of(name)), high=bound)
        for name, bound in rung.floors.items():
            if self.order is not None or name not in ORDERS.values():
                yield Check(name, self._of(name), low=bound)
        for name, value in rung.values.items():
            room = tolerance * abs(value)
            yield Check(name, self._of(name), value - room, value + room)
        if self.case.mass is not None:
            yield Check("mass_drift", abs(self._of("mass_drift")), high=self.case.mass)

    def _of(self, name: str) -> float:
        return self.quantities.get(name, math.nan)


def verify(cases: Iterable[Case], quick: bool = False) -> Iterator[Row]:
    """Run the rungs of the cases one by one; quick: only those marked so."""
    for case in cases:
        rungs = [rung for rung in case.rungs if rung.quick or not quick]
        if rungs:
            yield from _rows(case, rungs)


def _rows(case: Case, rungs: list[Rung]) -> Iterator[Row]:
    against = Finer(case.against) if isinstance(case.against, Setting) else case.against
    before: Row | None = None
    for rung in rungs:
        row = Row(case, rung, case.at(rung), measure(case.at(rung), against))
        before = row if before is None else replace(row, order=_orders(before, row))
        yield before


def _orders(coarse: Row, fine: Row) -> dict[str, float]:
    """Order of the errors in terms of 1/ne, 1/(np - 1) or the time step."""
    ratio = math.log(_fineness(fine) / _fineness(coarse))
    old, new = coarse.measure.quantities, fine.measure.quantities
    return {
        name: math.log(abs(old[name] / new[name])) / ratio
        for name in ORDERS
        if old.get(name) and new.get(name)
    }


def _fineness(row: Row) -> float:
    """What the rungs of the case differ in."""
    if row.case.along == "dt":
        return 1.0 / row.measure.dt
    return float(row.setting.ne if row.case.along == "ne" else row.setting.np - 1)


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
