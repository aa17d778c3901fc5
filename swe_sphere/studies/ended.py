"""How a run of a study ended, whatever happens."""

from collections.abc import Callable, Sequence

import numpy as np

from swe_sphere.errors import SweError, in_one_line
from swe_sphere.simulation.loop import Interrupted, Interruption
from swe_sphere.simulation.observers import Observer
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.simulation.summary import Summary

STOPPED = ("refused", "unstable", "solver-failed")
"""Ways in which a run ends itself and says why."""
ENDS = ("completed", *STOPPED, "timed-out", "failed")
"""How a run may have ended."""
BREAKDOWNS = (ArithmeticError, LookupError, MemoryError, RuntimeError, TypeError, ValueError)
"""Errors that are no answer to the user: a run that ends with one of them has failed."""


def attempt(work: Callable[[], Summary]) -> Summary:
    """Return what the work returns; an error in it is an end as well, but for Interrupted."""
    try:
        with np.errstate(all="ignore"):
            return work()
    except SweError as error:
        return Summary(error.status, in_one_line(error))
    except BREAKDOWNS as error:
        return Summary("failed", f"{type(error).__name__}: {in_one_line(error)}")


def stepped(
    sim: Simulation,
    observers: Sequence[Observer] = (),
    time_limit: float | None = None,
    interruption: Interruption | None = None,
) -> Summary:
    """Step a simulation to its end, as its `advance` does; any error of a step ends it too.

    Raises Interrupted where the user asked to stop.
    """

    def work() -> Summary:
        outcome = sim.advance(observers, time_limit, interruption)
        if outcome.status == "interrupted":
            raise Interrupted(outcome.reason)
        return Summary(outcome.status, in_one_line(outcome.reason or ""))

    return attempt(work)
