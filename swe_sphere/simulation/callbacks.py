"""What is called during a run: functions of the user's own, at steps or at simulated times."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from numbers import Real
from typing import Any, Protocol

from swe_sphere.errors import ConfigError, RunFailed, SweError
from swe_sphere.files.user_file import guarded
from swe_sphere.planet import DAY, HOUR
from swe_sphere.simulation.running import Running
from swe_sphere.simulation.time_plan import TimePlan

Function = Callable[[Any], Any]


class Observer(Protocol):
    """Something that looks at a run now and then; RunFailed from it ends the run."""

    def due(self, step: int) -> bool:
        """Whether it wants to see the state after that many steps."""

    def observe(self, sim: Running) -> None:
        """Look at the state."""


@dataclass(frozen=True)
class Callback:
    """A function that is given the simulation, and when: after every so many steps or seconds."""

    function: Function
    steps: int | None = None
    seconds: float | None = None
    """Simulated time [s]; the steps of a run are chosen so that they meet its multiples."""
    times: int | None = None
    """So many times in a run, as evenly as its steps allow."""

    @property
    def name(self) -> str:
        """What the function is called."""
        return str(getattr(self.function, "__name__", type(self.function).__name__))


def every(
    steps: int | None = None, *, hours: float | None = None, days: float | None = None
) -> Callable[[Function], Callback]:
    """Say when a callback is due, by steps or by simulated time; as a decorator or a call.

    Examples:
        >>> from swe_sphere import Simulation
        >>> from swe_sphere.simulation.callbacks import every
        >>> sim = Simulation("williamson2", ne=2, np=4, dt=3600)
        >>> depths = []
        >>> @every(hours=6)
        ... def look(sim):
        ...     depths.append(float(sim.state.h.max()))
        >>> sim.run(days=0.5, callbacks=[look]).status
        'completed'
        >>> len(depths)
        2

    Raises:
        ConfigError: none or more than one of the three, or one that is not positive.
    """
    units = ((steps, 1.0), (hours, HOUR), (days, DAY))
    asked = [(value, unit) for value, unit in units if value is not None]
    if len(asked) != 1 or not _can_be_met(*asked[0]) or (steps is not None and steps != int(steps)):
        raise ConfigError(
            "every: give a positive whole number of steps, or of hours, or of days, no less than a"
            " millisecond"
        )
    if steps is not None:
        return lambda function: Callback(function, steps=steps)
    value, unit = asked[0]
    return lambda function: Callback(function, seconds=value * unit)


def _can_be_met(value: object, unit: float) -> bool:
    """Whether it is a number; plans of time are made of milliseconds."""
    return isinstance(value, Real) and 1e-3 <= float(value) * unit < math.inf


def scheduled(callbacks: Iterable[Callback | Function]) -> list[Callback]:
    """All of them as callbacks: a plain function is called after every step.

    Raises:
        ConfigError: one that cannot be called, or no list of them.
    """
    if not isinstance(callbacks, Iterable):
        raise ConfigError(f"callbacks: give a list of functions, not {callbacks!r}")
    return [c if isinstance(c, Callback) else _at_every_step(c) for c in callbacks]


def _at_every_step(function: object) -> Callback:
    if not callable(function):
        raise ConfigError(f"a callback is a function of the simulation, not {function!r}")
    return Callback(function, steps=1)


class Scheduled:
    """A callback on the steps of a run, as an observer of it."""

    def __init__(self, callback: Callback, plan: TimePlan) -> None:
        self._callback = callback
        if callback.times is not None:
            self._every = plan.cycle * max(1, plan.steps // (plan.cycle * callback.times))
        else:
            self._every = callback.steps or round((callback.seconds or plan.dt) / plan.dt)
        if self._every > 1 and self._every % plan.cycle:
            raise ConfigError(
                f"every: {self._every} steps are no multiple of the {plan.cycle} that are taken at"
                " once (tracer-steps)"
            )

    def due(self, step: int) -> bool:
        """At the multiples."""
        return step % self._every == 0

    def observe(self, sim: Running) -> None:
        """Call it, if it is due; RunFailed says which function failed, and where."""
        if not self.due(sim.steps):
            return
        try:
            guarded(f"the callback {self._callback.name}", self._callback.function, sim)
        except (RunFailed, KeyboardInterrupt):
            raise
        except SweError as error:
            raise RunFailed(str(error)) from error


def intervals(callbacks: Sequence[Callback]) -> list[Fraction]:
    """The times [s] between calls of those that go by time."""
    return [
        Fraction(callback.seconds).limit_denominator(1000)
        for callback in callbacks
        if callback.seconds is not None
    ]
