"""Bounds that numbers of a run are held against: one class for all studies."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

Limits = Mapping[str, float | Mapping[Literal["low", "high"], float]]
"""A table of a study's file: `quantity = high`, or `quantity = {low = low, high = high}`."""


@dataclass(frozen=True)
class Bound:
    """The limits that a quantity must keep to, decided before the run."""

    quantity: str
    high: float = math.inf
    low: float = -math.inf
    always: bool = False
    """Whether it holds also for a run that was stopped early."""

    def __str__(self) -> str:
        if math.isinf(self.high):
            return f"{self.quantity} ≥ {self.low:g}"
        low = "" if math.isinf(self.low) else f"{self.low:g} ≤ "
        return f"{low}{self.quantity} ≤ {self.high:g}"


@dataclass(frozen=True)
class Check:
    """A bound and the number that it was held against."""

    bound: Bound
    obtained: float
    """NaN for what was not measured."""

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
        """How much of the bound is used: 1 is just within; infinite for NaN and infinities."""
        x, low, high = self.obtained, self.bound.low, self.bound.high
        if not math.isfinite(x):
            return math.inf
        if math.isinf(low):
            return x / high if high else (math.inf if x > high else 0.0)
        if math.isinf(high):
            return low / x if x > 0.0 else math.inf
        return abs(2.0 * x - low - high) / (high - low)

    def __str__(self) -> str:
        return f"{self.quantity} is {self.obtained:.6g}, not {self.bound}"


def read_bounds(table: Limits, always: bool = False) -> Iterator[Bound]:
    """The bounds that a table says; always: whether they hold for runs that were stopped too."""
    for quantity, limits in table.items():
        values = {"high": limits} if isinstance(limits, float) else limits
        yield Bound(quantity, values.get("high", math.inf), values.get("low", -math.inf), always)
