"""How a run of a study ended: in one word, in one line, and in numbers, whatever happens."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from swe_sphere.errors import SweError
from swe_sphere.planet import DAY
from swe_sphere.simulation.callbacks import Observer
from swe_sphere.simulation.execution import step_through
from swe_sphere.simulation.interrupt import Interrupted
from swe_sphere.simulation.running import Running
from swe_sphere.simulation.simulation import Simulation

__all__ = ["Ended", "attempt", "stepped"]

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
        return Ended(error.status, _line(error))
    except BREAKDOWNS as error:
        return Ended("failed", f"{type(error).__name__}: {_line(error)}")


def stepped(
    sim: Simulation,
    observers: Sequence[Observer] = (),
    tick: Callable[[str], None] | None = None,
    time_limit: float | None = None,
) -> Ended:
    """Step a simulation to its end; tick is told how far it is, time_limit is wall time [s].

    Raises:
        Interrupted: the user asked to stop.
    """
    outcome = step_through(sim, observers, None if tick is None else _teller(tick), time_limit)
    if outcome.status == "interrupted":
        raise Interrupted(outcome.reason)
    return Ended(outcome.status, _line(outcome.reason or ""), sim=sim)


def _teller(tick: Callable[[str], None]) -> Callable[[Running], None]:
    return lambda sim: tick(f"day {sim.time / DAY:.3g}, step {sim.steps} of {sim.plan.steps}")


def _line(text: object) -> str:
    """The text in one line."""
    return " ".join(str(text).split())
