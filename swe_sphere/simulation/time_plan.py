"""How many steps of which length: chosen where the user leaves it open, fitted to the frames."""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import reduce
from typing import TYPE_CHECKING, Any

import numpy as np

from swe_sphere.errors import ConfigError
from swe_sphere.planet import DAY, HOUR
from swe_sphere.settings.values import STEPPER, by_owner, convert
from swe_sphere.simulation.config import RunConfig

if TYPE_CHECKING:
    from swe_sphere.arrays import Array
    from swe_sphere.mesh import Mesh
    from swe_sphere.steppers import Stepper


MOST_STEPS = 10**9
SHORTEST = Fraction(1, 2)
"""A given step may be shortened to no less than this part of it."""


@dataclass(frozen=True)
class TimePlan:
    """Equal steps from the start to the end of a run."""

    dt: float
    """Length of a step [s]."""
    steps: int
    """Steps from the very start to the end."""
    frame_steps: int
    """Steps between frames."""
    wanted: float
    """Length of a step asked for, or chosen, before it was fitted to the frames [s]."""
    cycle: int = 1
    """Steps that are taken at once, with one step of tracers; all numbers here are multiples."""

    def time(self, step: int) -> float:
        """Time after so many steps [s], to the microsecond."""
        return round(step * self.dt, 6)

    def is_frame(self, step: int) -> bool:
        """Whether a frame is due after so many steps."""
        return step % self.frame_steps == 0 or step == self.steps


def free_steps(days: float, dt: float) -> TimePlan:
    """Steps of exactly dt [s] to the end or a little beyond, with no frame before it."""
    count = max(1, math.ceil(days * DAY / dt - 1e-9))
    return TimePlan(dt, count, count, dt)


def time_plan(
    days: float,
    every: float | None,
    dt: float,
    also: Iterable[Fraction] = (),
    cycle: int = 1,
    fewer: bool = False,
) -> TimePlan:
    """The plan of a new run.

    Args:
        days: length of the run [days]; 0 for a plan without a step.
        every: time between frames [h]; None: about a day.
        dt: time step [s], which may be shortened a little.
        also: further times [s] whose multiples fall on steps.
        cycle: steps that are taken at once.
        fewer: whether they may be fewer.

    Raises:
        ConfigError: the step does not go with the length or the frames.
    """
    if days == 0.0:
        return TimePlan(dt, 0, 1, dt)
    length = _milliseconds(days * DAY)
    if dt > length * (1 + 1e-9):
        raise ConfigError(f"dt={dt:g} s is longer than the whole run of {float(length):g} s")
    if length / Fraction(dt) > MOST_STEPS:
        raise ConfigError(f"dt={dt:g} s means more than {MOST_STEPS:.0e} steps: take a larger dt")
    interval = _interval(length, every, dt)
    common = reduce(common_measure, also, common_measure(length, interval))
    whole = common / _parts(common, cycle * Fraction(dt))
    cycle = min(cycle, _parts(whole, Fraction(dt))) if fewer else cycle
    step = whole / cycle
    if step < SHORTEST * Fraction(dt):
        raise ConfigError(
            f"no step near {dt:g} s fits both {float(length / 3600):g} h of run and frames"
            f" every {float(interval / 3600):g} h{_and_calls(also)}: change every, or take"
            f" dt={float(step):g} or less"
        )
    return TimePlan(float(step), int(length / step), int(interval / step), dt, cycle)


def _parts(length: Fraction, longest: Fraction) -> int:
    """Into how many equal parts, none longer than that, a length is divided."""
    return max(1, math.ceil(length / longest - Fraction(1, 10**9)))


def continued_plan(
    days: float,
    every: float | None,
    dt: float,
    done: int,
    also: Iterable[Fraction] = (),
    cycle: int = 1,
) -> TimePlan:
    """The plan of a run that goes on with steps of dt [s], `done` of which lie behind it.

    cycle: how many of them are taken at once.

    Raises:
        ConfigError: the length, the frames or further times are no whole number of those steps, or
            the end has been reached.
    """
    long = cycle * dt
    steps = cycle * _whole("days", days * DAY, long)
    if steps <= done:
        raise ConfigError(
            f"the run stands at day {done * dt / DAY:g} already: give more than days={days:g} (the"
            " length counts from the very start)"
        )
    for interval in also:
        _whole("every of a callback", float(interval), long)
    interval = _interval(_milliseconds(days * DAY), every, dt)
    frames = _whole("every", float(interval), long) if every else max(1, round(interval / long))
    return TimePlan(dt, steps, min(cycle * frames, steps), dt, cycle)


def _and_calls(also: Iterable[Fraction]) -> str:
    """The times between calls in words."""
    return "".join(f" and calls every {float(interval / 3600):g} h" for interval in also)


def _interval(length: Fraction, every: float | None, dt: float) -> Fraction:
    """Time between frames [s]: as asked, else the part of the run that is nearest to a day."""
    if every is not None:
        return min(length, _milliseconds(every * HOUR))
    return length / max(1, round(length / max(Fraction(DAY), Fraction(dt))))


def _milliseconds(seconds: float) -> Fraction:
    """The time as a fraction of seconds with a denominator of at most a thousand."""
    fraction = Fraction(seconds).limit_denominator(1000)
    if fraction <= 0:
        raise ConfigError(
            f"days or every of {seconds:g} s is too short: give at least a millisecond"
        )
    return fraction


def common_measure(a: Fraction, b: Fraction) -> Fraction:
    """The largest time of which both are whole multiples."""
    numerator = math.gcd(a.numerator * b.denominator, b.numerator * a.denominator)
    return Fraction(numerator, a.denominator * b.denominator)


def _whole(name: str, length: float, dt: float) -> int:
    steps = round(length / dt)
    if steps < 1 or abs(steps * dt - length) > 1e-6 * dt:
        raise ConfigError(
            f"{name}: {length / HOUR:g} h is no whole number of the steps of {dt:g} s that the run"
            " takes; choose a multiple"
        )
    return steps


UNLIMITED = 1e7
"""A limit above this [s] is none."""


@dataclass(frozen=True)
class StepChoice:
    """A time step before it is fitted to the frames."""

    dt: float
    """[s]"""
    rule: str
    """How it was chosen, in words."""


def choose_step(
    asked: float | None,
    days: float,
    stable_dt: float,
    safety: float,
    accurate: StepChoice,
    cautious: bool = False,
) -> StepChoice:
    """The step asked for [s], else one within the stability limit or, without one, an accurate one.

    days: length of the run, which an automatic step does not exceed; stable_dt: stability limit
    [s], infinite where there is none; safety: part of it to use; accurate: see `accurate_step`;
    cautious: whether an automatic step shall be an accurate one within the limit too.
    """
    if asked is not None:
        return StepChoice(asked, "as given")
    if stable_dt < UNLIMITED and not (cautious and safety * stable_dt > accurate.dt):
        return StepChoice(min(safety * stable_dt, days * DAY), f"{safety:g} of the stability limit")
    return replace(accurate, dt=min(accurate.dt, days * DAY))


def longest_step(config: RunConfig, days: float) -> StepChoice:
    """The outer step of an adaptive run of that length [days]: the time between frames."""
    interval = DAY if config.every is None else config.every * HOUR
    return StepChoice(min(interval, days * DAY), "time between frames, in which steps adapt")


def accurate_step(kind: type[Stepper], mesh: Mesh, fields: dict[str, Array]) -> StepChoice:
    """The step in which the fastest wind u, v (N,) [m s-1] passes so many of the finest spacings.

    The number is the stepper's `courant`, and the step its `longest` at the most.
    """
    wind, longest = float(np.hypot(fields["u"], fields["v"]).max()), kind.longest
    dt = min(longest, kind.courant * mesh.spacing()[0] / wind) if wind > 0.0 else longest
    return StepChoice(dt, f"advective Courant number {kind.courant:g}, at most {longest:g} s")


def stepper_options(kind: type[Stepper], config: RunConfig) -> dict[str, Any]:
    """Everything the stepper is built with besides model and dt: as asked for, else its defaults.

    Raises:
        ConfigError: the stepper takes no such option, or not that value.
    """
    known = inspect.signature(kind, eval_str=True).parameters
    # a default that depends on the scheme is an attribute of its class
    defaults = {
        name: getattr(kind, f"default_{name}", parameter.default)
        for name, parameter in known.items()
    }
    options: dict[str, Any] = {
        name: default
        for name, default in defaults.items()
        if isinstance(default, (bool, int, float, str))
    }
    for name, value in _asked(config).items():
        if name not in options:
            has = f"it has {', '.join(options)}" if options else "implicit steppers have some"
            raise ConfigError(f"stepper {kind.name} has no option {name!r}; {has}")
        options[name] = convert(f"stepper {kind.name}: {name}", known[name].annotation, value)
    return options


def _asked(config: RunConfig) -> dict[str, object]:
    flags = {"preconditioner": config.preconditioner, "tolerance": config.tolerance}
    given: dict[str, object] = {key: value for key, value in flags.items() if value is not None}
    settings = by_owner(config.settings).get(STEPPER, {})
    for name in given.keys() & settings.keys():
        raise ConfigError(f"{name} is given twice: by {name} and by set stepper.{name}")
    return given | settings
