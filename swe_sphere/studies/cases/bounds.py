"""Bounds that the numbers of a case must keep, and how much of them the numbers use."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

Limits = Mapping[str, float | Mapping[Literal["low", "high"], float]]
"""A table of a file of cases: `quantity = high`, or `quantity = {low = low, high = high}`."""


@dataclass(frozen=True)
class Bound:
    """The limits of a quantity, decided before the run."""

    quantity: str
    high: float = math.inf
    low: float = -math.inf
    always: bool = False
    """Whether it also applies to a run that was stopped early."""

    def __str__(self) -> str:
        if math.isinf(self.high):
            return f"{self.quantity} ≥ {self.low:g}"
        low = "" if math.isinf(self.low) else f"{self.low:g} ≤ "
        return f"{low}{self.quantity} ≤ {self.high:g}"


@dataclass(frozen=True)
class Check:
    """A bound and the number that is compared with it."""

    bound: Bound
    obtained: float
    """NaN for a quantity that was not measured."""

    @property
    def quantity(self) -> str:
        """Name of the number."""
        return self.bound.quantity

    @property
    def holds(self) -> bool:
        """Whether the number is within its bounds; NaN is not."""
        return self.bound.low <= self.obtained <= self.bound.high

    @property
    def used(self) -> float:
        """Fraction of the bound that is used: at most 1 within it, infinite for NaN."""
        x, low, high = self.obtained, self.bound.low, self.bound.high
        if not math.isfinite(x):
            return math.inf
        if math.isinf(low):
            return _used(x, high)
        if math.isinf(high):
            return _used(-x, -low)
        half = 0.5 * (high - low)
        return _used(abs(x - (low + half)), half)

    def __str__(self) -> str:
        return f"{self.quantity} is {self.obtained:.6g}, not {self.bound}"


def _used(x: float, high: float) -> float:
    """Return the fraction of an upper bound of either sign that x uses."""
    if high > 0.0:
        return max(x, 0.0) / high
    if high < 0.0 and x < 0.0:
        return high / x
    return 0.0 if x <= high else math.inf


def read_bounds(table: Limits, always: bool = False) -> Iterator[Bound]:
    """Yield the bounds of a table; an infinite one is none.  always: as `Bound.always`."""
    for quantity, limits in table.items():
        values = {"high": limits} if isinstance(limits, float) else limits
        bound = Bound(quantity, values.get("high", math.inf), values.get("low", -math.inf), always)
        if not (math.isinf(bound.high) and math.isinf(bound.low)):
            yield bound
