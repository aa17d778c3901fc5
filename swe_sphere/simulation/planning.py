"""The steps of a run: their length, as requested or chosen, fitted to the frames."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import reduce
from typing import TYPE_CHECKING, Any

import numpy as np

from swe_sphere.errors import ConfigError
from swe_sphere.files.user_file import call_custom
from swe_sphere.planet import DAY, HOUR
from swe_sphere.settings.values import convert

if TYPE_CHECKING:  # imports Warp
    from swe_sphere.equations.model import Model
    from swe_sphere.equations.spectrum import SpectralRadii
    from swe_sphere.steppers import Stepper

MOST_STEPS = 10**9
"""Largest number of steps of a run."""
LEAST_PART = Fraction(1, 2)
"""Smallest fraction to which a requested step may be shortened."""
SHORTEST_AUTOMATIC = Fraction(1, 20)
"""An automatic step may be shortened to this fraction of it or of a shorter time it must fit."""
UNLIMITED = 1e7
"""A stability limit above this [s] is treated as none."""
ROUNDING = 1.0 + 1e-9
"""Factor up to which one time counts as no longer than another."""
LONGEST_OF_TRACERS = 3.0 * HOUR
"""Longest automatic step of tracers [s] if the wind is not prescribed: it changes meanwhile."""
WORTH_A_CHANGE = 1.25
"""A step that fits is replaced by an automatic one that is longer by more than this factor."""
WIND_SAMPLES = 40
"""Number of times of a run among which the one of the strongest prescribed wind is found."""
LONG_RUN = 20.0
"""Length of a run [days] from which on winds may double (docs/results/steps.md)."""
HOUR_ROUNDING = 5e-5
"""Largest difference [h] between a time between frames and the fraction that it stands for."""


def stability_limit(kind: type[Stepper], radii: Sequence[SpectralRadii]) -> float:
    """Return the largest stable step [s] for `run_radii`, infinite without one.

    The strongest wind may use up the margin `safety`. ConfigError if a limit is not a number.
    """
    label = f"stable_dt of stepper {kind.name}"
    limits = [call_custom(label, kind.stable_dt, each) for each in radii]
    first, *later = (float(convert(label, float, each, finite=False)) for each in limits)
    return min([first, *(each / kind.safety for each in later)])


def safe_part(kind: type[Stepper], days: float) -> float:
    """Return the part of its stability limit that a stepper takes in a run of that length."""
    return kind.safety * (kind.long_run_factor if days > LONG_RUN else 1.0)


def run_radii(kind: type[Stepper], model: Model, times: Iterable[float]) -> list[SpectralRadii]:
    """Return a stepper's radii at the initial state with the prescribed winds of these times."""
    label, state = f"spectral radii of stepper {kind.name}", model.initial_state()
    return [call_custom(label, kind.spectral_radii, model, state, t) for t in times]


def limiting_times(model: Model, days: float) -> list[float]:
    """Return the times [s] that limit the steps of a run: 0, and that of the strongest wind.

    An unsteady wind is compared at irregular times, which no period fits, until one is undefined.
    """
    if not model.scene.unsteady_wind:
        return [0.0]
    golden, state, rates = 0.5 * (math.sqrt(5.0) - 1.0), model.initial_state(), dict[float, float]()
    with suppress(ConfigError):
        for t in (days * DAY * (k * golden % 1.0) for k in range(WIND_SAMPLES)):
            fields = model.fields(state, t)
            rates[t] = (np.hypot(fields["u"], fields["v"]) / np.sqrt(model.mesh.area)).max()
    return [0.0, max(rates, key=lambda t: rates[t])]


@dataclass(frozen=True)
class RunPlan:
    """Equal steps up to the end of a run; a few of another length may come first and last.

    number of steps   0 .. lead_steps ...... tail_begin ..... steps
    length of each     lead_dt |       dt         |   tail_dt
    time [s]                 origin                          the end
    """

    dt: float
    """Length of a step [s]."""
    steps: int
    """Steps from the start of the run to its end."""
    frame_steps: int
    """Steps between frames."""
    wanted_dt: float
    """Requested or chosen length of a step, before it was fitted to the frames [s]."""
    rule: str = "as given"
    """How the step was chosen, in words."""
    cycle: int = 1
    """Steps taken together with one of the tracers; divides numbers of steps since a resume."""
    lead_steps: int = 0
    """Number of steps before the first step of `dt`."""
    origin: float = 0.0
    """Time of the first step of `dt` [s]."""
    lead_dt: float = 0.0
    """Length of the steps from the present one to `origin` [s]."""
    tail_steps: int = 0
    """Number of steps of another length at the end."""
    tail_dt: float = 0.0
    """Length of the steps at the end [s]."""

    @property
    def tail_begin(self) -> int:
        """Number of steps before the steps at the end that have another length."""
        return self.steps - self.tail_steps

    def time(self, step: int) -> float:
        """Return the time [s] (to 1e-6) after that many steps; wrong for those before a resume."""
        if step < self.lead_steps:
            return round(self.origin - (self.lead_steps - step) * self.lead_dt, 6)
        ahead = max(0, min(step, self.steps) - self.tail_begin)
        equal = step - ahead - self.lead_steps
        return round(self.origin + equal * self.dt + ahead * self.tail_dt, 6)

    def length(self, step: int) -> float:
        """Return the length [s] of the step that follows that many steps."""
        if step < self.lead_steps:
            return self.lead_dt
        return self.tail_dt if self.tail_begin <= step < self.steps else self.dt

    def is_frame(self, step: int) -> bool:
        """Return whether a frame is due after that many steps."""
        return step == self.steps or self.is_multiple(step, self.frame_steps * self.dt)

    def is_multiple(self, step: int, seconds: float) -> bool:
        """Return whether the time after that many steps is a multiple of `seconds`."""
        if not self.lead_steps <= step <= self.tail_begin:
            return False
        # cycles from the origin to the next multiple: whole numbers if the steps meet multiples
        ahead = -self.origin % seconds / (self.cycle * self.dt)
        if abs(ahead - round(ahead)) > 1e-6 or seconds < 0.5 * self.dt:
            return False
        return (step - self.lead_steps - self.cycle * round(ahead)) % round(seconds / self.dt) == 0

    def is_sample(self, step: int, times: int) -> bool:
        """Return whether one of about `times` samples of a run is due after that many steps."""
        return (step - self.lead_steps) % self.interval(times) == 0

    def interval(self, times: int) -> int:
        """Return the number of steps between samples, of which a run has about `times`."""
        return self.cycle * max(1, self.steps // (self.cycle * times))


def free_steps(days: float, dt: float, cycle: int = 1) -> RunPlan:
    """Return steps of exactly dt [s] to the end or a little beyond, with no frame in between.

    cycle: their number is a multiple of it.
    """
    count = cycle * max(1, math.ceil(days * DAY / (cycle * dt) - 1e-9))
    return RunPlan(dt, count, count, dt)


def time_plan(
    days: float, every: float | Fraction | None, dt: float, also: Sequence[float] = (),
    cycle: int = 1, fewer: bool = False, automatic: bool = False,
) -> RunPlan:  # fmt: skip
    """Return the plan of a new run.

    days: length of the run [days]; 0: no step.  every: time between frames [h]; None: about a day.
    dt: time step [s]; may be shortened to half of it or, if `automatic`, to `SHORTEST_AUTOMATIC` of
    the smallest of it and the times that it must fit.  also: further times [s] whose multiples fall
    on steps.  cycle: steps that are taken together; fewer: True if cycle may be smaller.  The last
    steps are shorter if the end is no multiple of the others.  ConfigError if no step fits.
    """
    if days == 0.0:
        return RunPlan(dt, 0, 1, dt)
    length = _as_fraction(days * DAY)
    if dt > length * (1 + 1e-9):
        raise ConfigError(f"dt={dt:g} s is longer than the whole run of {float(length):g} s")
    if length / Fraction(dt) > MOST_STEPS:
        raise ConfigError(f"dt={dt:g} s means more than {MOST_STEPS:.0e} steps: take a larger dt")
    interval, calls = _interval(length, every, dt), [*map(_as_fraction, also)]

    def fitted(common: Fraction) -> tuple[Fraction, int]:
        """Return the longest step near dt of which cycles fill `common`, and the steps in each."""
        whole = common / _parts(common, cycle * Fraction(dt))
        together = min(cycle, _parts(whole, Fraction(dt))) if fewer else cycle
        return whole / together, together

    step, together = fitted(reduce(common_measure, [interval, *calls], length))
    if step < LEAST_PART * Fraction(dt):  # steps fit the times, but those at the end are shorter
        times = calls if every is None and calls else [interval, *calls]
        step, together = fitted(reduce(common_measure, times))
        shortest = LEAST_PART * Fraction(dt)
        if automatic:
            shortest = SHORTEST_AUTOMATIC * min(Fraction(dt), *times)
        if step < shortest:
            said = "".join(f" and callbacks or files every {time / HOUR:g} h" for time in also)
            raise ConfigError(
                f"no step near {dt:g} s fits frames every {float(interval / 3600):g} h{said}:"
                f" change every, or take dt={float(step):g} or less"
            )
    whole = int(length / (together * step)) * together
    left = length - whole * step
    tail = together if left else 0
    return RunPlan(
        float(step), whole + tail, together * round(interval / (together * step)), dt,
        cycle=together, tail_steps=tail, tail_dt=round(float(left / together), 6),
    )  # fmt: skip


def _parts(length: Fraction, longest: Fraction) -> int:
    """Return the number of equal parts, none longer than `longest`, of a length."""
    return max(1, math.ceil(length / longest - Fraction(1, 10**9)))


def continued_plan(
    plan: RunPlan, days: float, every: float | None, done: int, also: Sequence[float] = ()
) -> RunPlan:
    """Return the plan of a run that continues with the steps of an earlier plan.

    The last steps (one cycle) are shorter if the end is no multiple of the others.  days, every,
    also: as in `time_plan`.  done: number of steps taken so far.  Raises ConfigError if frames or
    further times are no whole number of steps, or if the run has already reached that length.
    """
    now, cycle, origin, length = plan.time(done), plan.cycle, plan.origin, _as_fraction(days * DAY)
    if (end := float(length)) <= now + 1e-6:
        raise ConfigError(
            f"the run is already at day {now / DAY:g}: give more than days={days:g} (the length"
            " counts from the initial state)"
        )
    long = cycle * plan.dt
    for seconds in also:
        _check_whole("every of a callback or file", seconds, long, origin)
    interval = _interval(length, every, plan.dt)
    if every is not None:
        _check_whole("every", float(interval), long, origin)
    frame_steps = cycle * max(1, round(interval / long))
    whole = math.floor((end - origin) / long + 1e-6)
    left = end - origin - whole * long
    tail = cycle if left > 1e-6 * plan.dt else 0
    steps = plan.lead_steps + cycle * whole + tail
    last = round(left / cycle, 6) if tail else 0.0
    return replace(
        plan, steps=steps, frame_steps=frame_steps, tail_steps=tail, tail_dt=last, wanted_dt=plan.dt
    )


def led_plan(plan: RunPlan, done: int, now: float, also: Sequence[float] = ()) -> RunPlan:
    """Return the plan of a new run as one that begins later, with the same end and frames.

    Steps of another length lead to the next frame or further time, unless the present time is on
    the grid of the plan.  done, now: number and time [s] of steps so far.  also: as in `time_plan`.
    """
    end, long = plan.time(plan.steps), plan.cycle * plan.dt
    interval = plan.frame_steps * plan.dt
    first, origin, lead = done, now, 0.0
    tail_time = end - plan.tail_steps * plan.tail_dt
    if abs(round(now / long) * long - now) > 1e-6 * plan.dt or now > tail_time:
        origin = min(end, *(math.ceil(now / each + 1e-9) * each for each in (interval, *also)))
        ahead = Fraction(origin - now)
        first += plan.cycle * _parts(ahead, Fraction(plan.cycle * plan.wanted_dt))
        lead = float(ahead / (first - done))
    plan = replace(plan, lead_steps=first, origin=origin, lead_dt=lead)
    if origin == end:
        frame_steps = max(1, round(interval / lead))
        return replace(plan, dt=lead, steps=first, frame_steps=frame_steps, tail_steps=0)
    return replace(plan, steps=first + plan.steps - round(origin / plan.dt))


def _interval(length: Fraction, every: float | Fraction | None, dt: float) -> Fraction:
    """Return the time between frames [s]: as requested, else the part of the run nearest a day."""
    if every is None:
        return length / max(1, round(length / max(Fraction(DAY), Fraction(dt))))
    if isinstance(every, Fraction):
        return min(length, 3600 * every)
    return min(length, _as_fraction(3600 * meant_hours(every)))


def meant_hours(hours: float) -> Fraction:
    """Return the fraction of an hour for which a rounded number stands: 1/3 for 0.333333."""
    near = Fraction(hours).limit_denominator(60)
    return near if near > 0 and abs(near - Fraction(hours)) < HOUR_ROUNDING else Fraction(hours)


def _as_fraction(seconds: float | Fraction) -> Fraction:
    """Return the nearest fraction of seconds with a denominator of at most a thousand."""
    if (fraction := Fraction(seconds).limit_denominator(1000)) <= 0:
        raise ConfigError(
            f"days or every of {float(seconds):g} s is too short: give at least a millisecond"
        )
    return fraction


def common_measure(a: Fraction, b: Fraction) -> Fraction:
    """Return the largest time of which both times are whole multiples."""
    numerator = math.gcd(a.numerator * b.denominator, b.numerator * a.denominator)
    return Fraction(numerator, a.denominator * b.denominator)


def _check_whole(name: str, length: float, dt: float, origin: float) -> None:
    """Raise ConfigError unless steps of dt from the origin meet all multiples of a length [s]."""
    steps, ahead = round(length / dt), -origin % length / dt
    if steps < 1 or abs(steps * dt - length) / dt > 1e-6:
        nearest = sorted({max(1, math.floor(length / dt)), math.ceil(length / dt)})
        raise ConfigError(
            f"{name}: {length / HOUR:g} h is not a whole number of steps of {dt:g} s:"
            f" choose {' or '.join(f'{n * dt / HOUR:.9g}' for n in nearest)} h, or dt=auto"
        )
    if abs(ahead - round(ahead)) > 1e-6:
        raise ConfigError(
            f"{name}: no step of {dt:g} s from day {origin / DAY:g} on ends at a multiple of"
            f" {length / HOUR:g} h: leave {name} out, or take dt=auto"
        )


def automatic_step(sim: Any, days: float) -> tuple[float, str]:
    """Return an automatic step [s], and its rule in words.

    It is a safe fraction of the stability limit. Without a limit, the fastest initial or prescribed
    wind has the advective Courant number of the stepper on the finest spacing of the mesh, in a
    step that is at most the longest one of the stepper. days: rest of the run, which no step
    exceeds. Raises ConfigError if the stability limit is not a positive number.
    """
    kind, limit = sim.stepper_class, sim.stable_dt()
    safety, state = safe_part(kind, sim.days), sim.model.initial_state()
    winds = [sim.model.fields(state, t) for t in sim.limiting_times()]
    if not limit > 0.0:
        raise ConfigError(
            f"the stability limit of {kind.name} is {limit:g} s: choose a step with --dt"
        )
    wind, accurate = max(float(np.hypot(x["u"], x["v"]).max()) for x in winds), kind.longest
    if wind > 0.0:
        accurate = min(accurate, kind.courant * sim.mesh.spacing()[0] / wind)
    # the stability limit of a fluid at rest does not bound the waves once there is a wind
    misleading = kind.family == "imex" and wind == 0.0 and safety * limit > accurate
    if limit < UNLIMITED and not misleading:
        return min(safety * limit, days * DAY), f"{safety:.3g} of the stability limit"
    rule = f"advective Courant number {kind.courant:g}, at most {kind.longest:g} s"
    return min(accurate, days * DAY), rule


def plan_run(sim: Any, also: Sequence[float] = ()) -> RunPlan:
    """Return the plan of a run from the present state, with the requested or an automatic step.

    A requested step, once fitted, is kept.  An automatic one is kept if it fits, unless a much
    longer one fits too.  also: as in `time_plan`, whose errors are raised.
    """
    config, days, every, done = sim.config, sim.days, sim.config.every, sim.steps
    also = [time for time in also if time <= days * DAY]  # others never come
    automatic, present = config.dt == "auto", None
    if done:
        try:
            present = continued_plan(sim.equal_steps, days, every, done, also)
            if not automatic:
                return present
        except ConfigError:
            if not automatic or days * DAY <= sim.time + 1e-6:
                raise
    dt, rule, ahead = config.dt, "as given", days - sim.time / DAY if days else 1.0
    if automatic and config.adaptive is None:
        dt, rule = automatic_step(sim, ahead)
    elif automatic:
        dt = min(DAY if every is None else every * HOUR, ahead * DAY)
        rule = "time between frames, in which steps adapt"
    cycle, fewer = tracer_cycle(sim, dt), config.tracer_steps == "auto"
    plan = time_plan(days, every, dt, also, cycle, fewer, automatic)
    if done:
        plan = led_plan(plan, done, sim.time, also)
        if present is not None and present.length(done) <= ROUNDING * dt:
            long = present.dt >= plan.dt / WORTH_A_CHANGE
            # where only the tail is left, a resumed run must end with the same steps
            if (done == present.tail_begin) if present.tail_steps else long:
                return present
    return replace(plan, rule=rule)


def tracer_cycle(sim: Any, dt: float) -> int:
    """Return the steps of dt [s] in one step of the tracers: as requested, or as many as allowed.

    Raises ConfigError if these are too many, or if tracers cannot take separate steps.
    """
    from swe_sphere.steppers.tracer_steps import tracer_limit, why_not

    if (asked := sim.config.tracer_steps) == 1:
        return 1
    reason = why_not(sim.model, sim.stepper_class, sim.config.adaptive)
    if reason and asked != "auto":
        raise ConfigError(f"tracer-steps={asked}: {reason}; leave tracer-steps out")
    limit = 0.0 if reason else tracer_limit(sim.model)
    if asked == "auto":
        longest = min(limit, LONGEST_OF_TRACERS if sim.scene.wind is None else math.inf)
        return max(1, int(longest / dt)) if math.isfinite(longest) else 1
    if asked * dt > limit * ROUNDING:
        raise ConfigError(
            f"tracer-steps={asked}: the longest step of the tracers is {limit:.4g} s: take at"
            f" most {max(1, int(limit / dt))} steps of {dt:.4g} s together"
        )
    return int(asked)


def with_cycle(sim: Any, plan: RunPlan) -> RunPlan:
    """Return the same steps, as many of them together as the configuration requests or allows.

    Raises ConfigError unless a requested number divides the steps in all and those between frames.
    """
    most, both = tracer_cycle(sim, plan.dt), math.gcd(plan.steps, plan.frame_steps)
    if sim.config.tracer_steps == "auto":
        most = max(k for k in range(1, most + 1) if both % k == 0)
    if both % most:
        raise ConfigError(f"tracer-steps={most}: {both} steps between frames are no multiple of it")
    return replace(plan, cycle=most)
