"""How a run of a study ended, whatever happens, and the bounds that its numbers are held to."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from swe_sphere.errors import SweError, in_one_line
from swe_sphere.simulation.callbacks import Observer
from swe_sphere.simulation.execution import step_through
from swe_sphere.simulation.interrupt import Interrupted, Interruption
from swe_sphere.simulation.running import Running
from swe_sphere.simulation.simulation import Simulation

STOPPED = ("refused", "unstable", "solver-failed")
"""Ways in which a run ends itself and says why."""
ENDS = ("completed", *STOPPED, "timed-out", "failed")
"""How a run may have ended."""
BREAKDOWNS = (ArithmeticError, LookupError, MemoryError, RuntimeError, TypeError, ValueError)
"""Errors that are no answer to the user: a run that ends with one of them has failed."""


@dataclass
class Ended:
    """How a run ended."""

    status: str = "completed"
    """As `Summary.status`."""
    reason: str = ""
    numbers: dict[str, float] = field(default_factory=dict)
    sim: Simulation | None = None
    """The run, at its end."""

    @property
    def completed(self) -> bool:
        """Whether it got to its end."""
        return self.status == "completed"


def attempt(work: Callable[[], Ended]) -> Ended:
    """What the work comes to; an error in it is an end as well.

    Raises:
        Interrupted: the user asked to stop.
    """
    try:
        with np.errstate(all="ignore"):
            return work()
    except SweError as error:
        return Ended(error.status, in_one_line(error))
    except BREAKDOWNS as error:
        return Ended("failed", f"{type(error).__name__}: {in_one_line(error)}")


def stepped(
    sim: Simulation,
    observers: Sequence[Observer] = (),
    tick: Callable[[Running], None] | None = None,
    time_limit: float | None = None,
    interruption: Interruption | None = None,
) -> Ended:
    """Step a simulation to its end, as `step_through` does; an error of a user's step is one too.

    Raises:
        Interrupted: the user asked to stop.
    """

    def work() -> Ended:
        outcome = step_through(sim, observers, tick, time_limit, interruption)
        if outcome.status == "interrupted":
            raise Interrupted(outcome.reason)
        return Ended(outcome.status, in_one_line(outcome.reason or ""), sim=sim)

    return attempt(work)


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
    """Fraction of an upper bound of either sign that x uses."""
    if high > 0.0:
        return max(x, 0.0) / high
    if high < 0.0 and x < 0.0:
        return high / x
    return 0.0 if x <= high else math.inf


def read_bounds(table: Limits, always: bool = False) -> Iterator[Bound]:
    """The bounds that a table says; always: whether they hold for runs that were stopped too."""
    for quantity, limits in table.items():
        values = {"high": limits} if isinstance(limits, float) else limits
        yield Bound(quantity, values.get("high", math.inf), values.get("low", -math.inf), always)
