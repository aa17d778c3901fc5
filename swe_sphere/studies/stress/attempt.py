"""Running one setting of a trial: how it ended, in one word and in one line, and in numbers."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from swe_sphere.equations.effect_settings import apply_settings
from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError, RunFailed, TimedOut, Unstable
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY
from swe_sphere.simulation.config import RunConfig, make_config
from swe_sphere.simulation.health import HealthCheck
from swe_sphere.simulation.interrupt import Interruption
from swe_sphere.simulation.loop import Loop
from swe_sphere.simulation.owner_settings import effect_settings
from swe_sphere.simulation.plan import TimePlan, time_plan
from swe_sphere.simulation.sampler import Sampler
from swe_sphere.simulation.setup import make_mesh, make_model, make_scene
from swe_sphere.simulation.snapshot import Array
from swe_sphere.simulation.stepping import accurate_step, choose_step, stepper_options
from swe_sphere.studies.stress.probes import PROBES
from swe_sphere.studies.stress.series import Series
from swe_sphere.studies.stress.trial import Trial

if TYPE_CHECKING:
    from swe_sphere.equations.model import Model
    from swe_sphere.steppers import Stepper

__all__ = ["Ended", "attempt", "config_of", "line", "ready"]

Tick = Callable[[str], None]


@dataclass
class Ended:
    """How a run ended."""

    status: str = "completed"
    """completed, refused (before the first step), unstable, solver-failed, timed-out, crashed."""
    reason: str = ""
    numbers: dict[str, float] = field(default_factory=dict)
    fields: dict[str, Array] = field(default_factory=dict)
    """u, v, h at the end of a run that was completed."""
    mesh: Mesh | None = None


@dataclass(frozen=True)
class Ready:
    """A run before its first step."""

    model: Model
    stepper: Stepper
    plan: TimePlan
    limit: float
    """Stability limit of the stepper [s]."""
    gravity: float
    """1 over the spectral radius [s]."""


def attempt(trial: Trial, tick: Tick | None = None) -> Ended:
    """Run the setting to its end or to where it fails, whatever happens.

    Raises:
        Interrupted: the user asked to stop.
    """
    began = time.perf_counter()
    try:
        with np.errstate(all="ignore"):
            ended = _stepped(trial, ready(trial), tick)
    except ConfigError as error:
        ended = Ended("refused", line(error))
    except RunFailed as error:
        ended = Ended("solver-failed", line(error))
    except (
        ArithmeticError,
        LookupError,
        MemoryError,
        RuntimeError,
        TypeError,
        ValueError,
    ) as error:
        ended = Ended("crashed", f"{type(error).__name__}: {line(error)}")
    ended.numbers["seconds"] = time.perf_counter() - began
    return ended


def config_of(trial: Trial) -> RunConfig:
    """The configuration of the run."""
    scene = {} if trial.scene is None else {"scene": "constructed"}
    return make_config({"time_limit": trial.seconds, **scene, **trial.run})


def ready(trial: Trial) -> Ready:
    """Everything up to the first step.

    Raises:
        ConfigError: it cannot be run.
    """
    config = config_of(trial)
    scene = _scene(trial, config)
    model = make_model(config, scene, make_mesh(config, scene))
    from swe_sphere.steppers import get_stepper

    kind, state = get_stepper(config.stepper), model.initial_state()
    spectrum = kind.spectrum(model, state)
    limit = kind.stable_dt(spectrum.wave, spectrum.dissipation)
    radius = model.spectrum(state).wave
    gravity = 1.0 / radius if radius > 0.0 else math.inf
    plan = _plan(trial, config, model, (limit, kind.safety, gravity))
    stepper = kind(model, plan.dt, **stepper_options(kind, config))
    stepper.start(state)
    return Ready(model, stepper, plan, limit, gravity)


def _scene(trial: Trial, config: RunConfig) -> Scene:
    if trial.scene is None:
        return make_scene(config)
    return apply_settings(trial.scene(), effect_settings(config.settings))


def _plan(
    trial: Trial, config: RunConfig, model: Model, limits: tuple[float, float, float]
) -> TimePlan:
    """Steps as the trial has them, else as an ordinary run would choose them."""
    limit, safety, gravity = limits
    days = model.scene.days if config.days is None else config.days
    if trial.part is not None or trial.courant is not None:
        own = trial.part is not None and math.isfinite(limit)
        dt = (trial.part or 1.0) * limit if own else _implicit_step(trial, model, gravity)
        count = max(1, math.ceil(days * DAY / dt - 1e-9))
        if trial.steps is not None:
            whole = max(1, math.floor(days * DAY / dt))
            count = trial.steps if config.days is None else min(trial.steps, whole)
        return TimePlan(dt, count, count, dt)
    accurate = accurate_step(model.mesh, model.fields(model.initial_state()))
    asked = None if config.dt == "auto" else config.dt
    return time_plan(days, None, choose_step(asked, days, limit, safety, accurate).dt)


def _implicit_step(trial: Trial, model: Model, gravity: float) -> float:
    """The step in gravity-wave limits [s], within the advective Courant number it may have."""
    dt = (trial.courant or 1.0) * gravity
    if trial.advective is None:
        return dt
    u, v, _ = model.scene.initial(model.mesh.lon, model.mesh.lat)
    wind = float(np.hypot(u, v).max())
    return min(dt, trial.advective * model.mesh.spacing()[0] / wind) if wind > 0.0 else dt


def _stepped(trial: Trial, run: Ready, tick: Tick | None) -> Ended:
    model, plan = run.model, run.plan
    start = _fields(model)
    sampler = Sampler(model, lambda: plan.dt, start)
    series = Series(sampler, plan, [PROBES[name](model.mesh) for name in trial.probes])
    health = HealthCheck(model, start, f"dt = {plan.dt:.6g} s, stability limit {run.limit:.4g} s")
    report = _reporter(tick, plan)
    loop = Loop(model, run.stepper, plan, health, [series], report, trial.seconds)
    series.observe(loop.moment())
    status, reason = _looped(loop)
    numbers = series.numbers() | _costs(run, loop)
    done = status == "completed"
    return Ended(status, reason, numbers, dict(loop.moment().fields) if done else {}, model.mesh)


def _looped(loop: Loop) -> tuple[str, str]:
    try:
        with Interruption() as interruption:
            loop.run(interruption)
    except Unstable as error:
        return "unstable", line(error)
    except TimedOut as error:
        return "timed-out", line(error)
    except RunFailed as error:
        return "solver-failed", line(error)
    return "completed", ""


def _reporter(tick: Tick | None, plan: TimePlan) -> Callable[[int], None] | None:
    if tick is None:
        return None
    return lambda step: tick(f"day {plan.time(step) / DAY:.3g}, step {step} of {plan.steps}")


def _costs(run: Ready, loop: Loop) -> dict[str, float]:
    costs = run.stepper.costs()
    names = ("newton_iterations", "krylov_iterations", "rejected_steps")
    return {
        "dt": run.plan.dt,
        "dt_over_gravity": run.plan.dt / run.gravity,
        "steps": float(run.stepper.steps),
        "step_seconds": loop.wall_seconds,
        **{name: float(costs[name]) for name in names if name in costs},
    }


def _fields(model: Model) -> dict[str, Array]:
    state = model.initial_state()
    derived = {"vorticity": model.vorticity(state), "divergence": model.divergence(state)}
    return model.fields(state) | derived


def line(error: Exception) -> str:
    """The message in one line."""
    return " ".join(str(error).split())
