"""The steps of a run: their length, as requested or chosen, fitted to the frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import reduce
from typing import Any

import numpy as np

from swe_sphere.errors import ConfigError
from swe_sphere.planet import DAY, HOUR

MOST_STEPS = 10**9
SHORTEST = Fraction(1, 2)
"""A given step may be shortened to no less than this part of it."""
UNLIMITED = 1e7
"""A stability limit above this [s] is treated as none."""
ROUNDING = 1.0 + 1e-9
LONGEST_OF_TRACERS = 3.0 * HOUR
"""Longest automatic step of tracers in a flow that is stepped, and so changes meanwhile [s]."""


@dataclass(frozen=True)
class RunPlan:
    """Equal steps from the start to the end of a run."""

    dt: float
    """Length of a step [s]."""
    steps: int
    """Steps from the start of the run to its end."""
    frame_steps: int
    """Steps between frames."""
    wanted: float
    """Requested or chosen length of a step, before it was fitted to the frames [s]."""
    rule: str = "as given"
    """How the step was chosen, in words."""
    cycle: int = 1
    """Steps that are taken together with one step of the tracers; divides all other counts."""

    def time(self, step: int) -> float:
        """Return the time after so many steps [s], to the microsecond."""
        return round(step * self.dt, 6)

    def is_frame(self, step: int) -> bool:
        """Return whether a frame is due after so many steps."""
        return step % self.frame_steps == 0 or step == self.steps

    def interval(self, times: int) -> int:
        """Return the steps between samples of which a run has about so many."""
        return self.cycle * max(1, self.steps // (self.cycle * times))


def free_steps(days: float, dt: float) -> RunPlan:
    """Return steps of exactly dt [s] to the end or a little beyond, with no frame before it."""
    count = max(1, math.ceil(days * DAY / dt - 1e-9))
    return RunPlan(dt, count, count, dt)


def time_plan(
    days: float,
    every: float | None,
    dt: float,
    also: Sequence[float] = (),
    cycle: int = 1,
    fewer: bool = False,
) -> RunPlan:
    """Return the plan of a new run.

    days: length of the run [days]; 0 for a plan without a step.  every: time between frames [h];
    None: about a day.  dt: time step [s], which may be shortened a little.  also: further times [s]
    whose multiples fall on steps.  cycle: steps that are taken together; fewer: or fewer of them.
    Raises ConfigError where no step near dt fits the length and the frames.
    """
    if days == 0.0:
        return RunPlan(dt, 0, 1, dt)
    length = _milliseconds(days * DAY)
    if dt > length * (1 + 1e-9):
        raise ConfigError(f"dt={dt:g} s is longer than the whole run of {float(length):g} s")
    if length / Fraction(dt) > MOST_STEPS:
        raise ConfigError(f"dt={dt:g} s means more than {MOST_STEPS:.0e} steps: take a larger dt")
    interval = _interval(length, every, dt)
    common = reduce(common_measure, map(_milliseconds, also), common_measure(length, interval))
    whole = common / _parts(common, cycle * Fraction(dt))
    cycle = min(cycle, _parts(whole, Fraction(dt))) if fewer else cycle
    step = whole / cycle
    if step < SHORTEST * Fraction(dt):
        calls = "".join(f" and calls every {time / HOUR:g} h" for time in also)
        raise ConfigError(
            f"no step near {dt:g} s fits both {float(length / 3600):g} h of run and frames"
            f" every {float(interval / 3600):g} h{calls}: change every, or take"
            f" dt={float(step):g} or less"
        )
    return RunPlan(float(step), int(length / step), int(interval / step), dt, cycle=cycle)


def _parts(length: Fraction, longest: Fraction) -> int:
    """Return the number of equal parts, none longer than `longest`, of a length."""
    return max(1, math.ceil(length / longest - Fraction(1, 10**9)))


def continued_plan(
    plan: RunPlan, days: float, every: float | None, done: int, also: Sequence[float] = ()
) -> RunPlan:
    """Return the plan of a run that continues with the steps of an earlier plan.

    days, every, also: as of `time_plan`.  done: number of steps taken so far.  Raises ConfigError
    where the length, the frames or the further times are no whole number of steps, or where the run
    has already reached that length.
    """
    dt, long = plan.dt, plan.cycle * plan.dt
    steps = plan.cycle * _whole("days", days * DAY, long)
    if steps <= done:
        raise ConfigError(
            f"the run stands at day {done * dt / DAY:g} already: give more than days={days:g} (the"
            " length counts from the very start)"
        )
    for seconds in also:
        _whole("every of a callback", seconds, long)
    interval = _interval(_milliseconds(days * DAY), every, dt)
    frames = _whole("every", float(interval), long) if every else max(1, round(interval / long))
    return replace(plan, steps=steps, frame_steps=min(plan.cycle * frames, steps), wanted=dt)


def _interval(length: Fraction, every: float | None, dt: float) -> Fraction:
    """Return the time between frames [s]: as requested, else the part of the run nearest a day."""
    if every is not None:
        return min(length, _milliseconds(every * HOUR))
    return length / max(1, round(length / max(Fraction(DAY), Fraction(dt))))


def _milliseconds(seconds: float) -> Fraction:
    """Return a time as a fraction of seconds with a denominator of at most a thousand."""
    fraction = Fraction(seconds).limit_denominator(1000)
    if fraction <= 0:
        raise ConfigError(
            f"days or every of {seconds:g} s is too short: give at least a millisecond"
        )
    return fraction


def common_measure(a: Fraction, b: Fraction) -> Fraction:
    """Return the largest time of which both times are whole multiples."""
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


def automatic_step(sim: Any, days: float) -> tuple[float, str]:
    """Return an automatic step [s], and its rule in words.

    It is a safe part of the stability limit.  Where there is no limit, the fastest initial wind has
    the advective Courant number of the stepper on the finest spacing of the mesh, in a step that is
    at most the longest one of the stepper.  days: length of the run, which no step exceeds.  Raises
    ConfigError where the stability limit is no positive number.
    """
    kind, limit = sim.kind, sim.stable_dt()
    fields = sim.model.fields(sim.model.initial_state(), 0.0)
    if not limit > 0.0:
        raise ConfigError(
            f"the stability limit of {kind.name} is {limit:g} s: choose a step with --dt"
        )
    wind, accurate = float(np.hypot(fields["u"], fields["v"]).max()), kind.longest
    if wind > 0.0:
        accurate = min(accurate, kind.courant * sim.mesh.spacing()[0] / wind)
    # the limit of a fluid at rest, whose wind is yet to come, does not bound its waves
    misleading = kind.family == "imex" and wind == 0.0 and kind.safety * limit > accurate
    if limit < UNLIMITED and not misleading:
        return min(kind.safety * limit, days * DAY), f"{kind.safety:g} of the stability limit"
    rule = f"advective Courant number {kind.courant:g}, at most {kind.longest:g} s"
    return min(accurate, days * DAY), rule


def plan_run(sim: Any, also: Sequence[float] = ()) -> RunPlan:
    """Return the plan of a new run, with the requested step or else an automatic one.

    also, ConfigError: as of `time_plan`.
    """
    config, length = sim.config, sim.days or 1.0
    if config.dt != "auto":
        dt, rule = config.dt, "as given"
    elif config.adaptive is None:
        dt, rule = automatic_step(sim, length)
    else:
        interval = DAY if config.every is None else config.every * HOUR
        dt, rule = min(interval, length * DAY), "time between frames, in which steps adapt"
    cycle, automatic = tracer_cycle(sim, dt), config.tracer_steps == "auto"
    return replace(time_plan(sim.days, config.every, dt, also, cycle, automatic), rule=rule)


def tracer_cycle(sim: Any, dt: float) -> int:
    """Return the steps of dt [s] for one step of the tracers: as requested, or as many as may be.

    Raises ConfigError where that is too many, or where tracers cannot have their own steps.
    """
    from swe_sphere.steppers.tracer_steps import tracer_limit, why_not

    asked = sim.config.tracer_steps
    if asked == 1:
        return 1
    reason = why_not(sim.model, sim.kind, sim.config.adaptive)
    if reason and asked != "auto":
        raise ConfigError(f"tracer-steps={asked}: {reason}; leave tracer-steps out")
    limit = 0.0 if reason else tracer_limit(sim.model)
    if asked == "auto":
        longest = min(limit, LONGEST_OF_TRACERS if sim.scene.wind is None else math.inf)
        return max(1, int(longest / dt)) if math.isfinite(longest) else 1
    if asked * dt > limit * ROUNDING:
        raise ConfigError(
            f"tracer-steps={asked}: the longest step of the tracers is {limit:.4g} s; of"
            f" {dt:.4g} s take {max(1, int(limit / dt))} at once at the most"
        )
    return int(asked)


def with_cycle(sim: Any, plan: RunPlan) -> RunPlan:
    """Return the same steps, as many of them together as the configuration requests or allows.

    Raises ConfigError where the steps between frames are no multiple of a requested number.
    """
    most, both = tracer_cycle(sim, plan.dt), math.gcd(plan.steps, plan.frame_steps)
    if sim.config.tracer_steps == "auto":
        most = max(k for k in range(1, most + 1) if both % k == 0)
    if both % most:
        raise ConfigError(f"tracer-steps={most}: {both} steps between frames are no multiple of it")
    return replace(plan, cycle=most)
