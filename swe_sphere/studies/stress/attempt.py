"""Running one setting of a trial: how it ended, in one word and in one line, and in numbers."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY
from swe_sphere.simulation.config import RunConfig, make_config
from swe_sphere.simulation.execution import step_through
from swe_sphere.simulation.interrupt import Interrupted
from swe_sphere.simulation.plan import TimePlan
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.simulation.snapshot import Array
from swe_sphere.simulation.supplied import Supplied
from swe_sphere.studies.stress.probes import PROBES
from swe_sphere.studies.stress.series import Series
from swe_sphere.studies.stress.trial import Trial

__all__ = ["Ended", "attempt", "config_of", "line", "ready"]

Tick = Callable[[str], None]


@dataclass
class Ended:
    """How a run ended."""

    status: str = "completed"
    """As for `Outcome`; crashed: with an error that is no answer to the user."""
    reason: str = ""
    numbers: dict[str, float] = field(default_factory=dict)
    fields: dict[str, Array] = field(default_factory=dict)
    """u, v, h at the end of a run that was completed."""
    mesh: Mesh | None = None


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


def ready(trial: Trial) -> Simulation:
    """The run before its first step.

    Raises:
        ConfigError: it cannot be run.
    """
    scene = None if trial.scene is None else trial.scene()
    sim = Simulation.from_config(config_of(trial), Supplied(scene=scene))
    sim.begin(_plan(trial, sim))
    return sim


def _plan(trial: Trial, sim: Simulation) -> TimePlan | None:
    """Steps as the trial has them, or None to have them chosen as those of an ordinary run."""
    if trial.part is None and trial.courant is None:
        return None
    own = trial.part is not None and math.isfinite(sim.stable_dt)
    dt = (trial.part or 1.0) * sim.stable_dt if own else _implicit_step(trial, sim)
    count = max(1, math.ceil(sim.days * DAY / dt - 1e-9))
    if trial.steps is not None:
        whole = max(1, math.floor(sim.days * DAY / dt))
        count = trial.steps if sim.config.days is None else min(trial.steps, whole)
    return TimePlan(dt, count, count, dt)


def _gravity_limit(sim: Simulation) -> float:
    """1 over the spectral radius at the start [s]."""
    radius = sim.model.spectrum(sim.model.initial_state()).wave
    return 1.0 / radius if radius > 0.0 else math.inf


def _implicit_step(trial: Trial, sim: Simulation) -> float:
    """The step in gravity-wave limits [s], within the advective Courant number it may have."""
    dt = (trial.courant or 1.0) * _gravity_limit(sim)
    if trial.advective is None:
        return dt
    wind = float(np.hypot(sim.start["u"], sim.start["v"]).max())
    return min(dt, trial.advective * sim.mesh.spacing()[0] / wind) if wind > 0.0 else dt


def _stepped(trial: Trial, sim: Simulation, tick: Tick | None) -> Ended:
    series = Series(sim.plan, [PROBES[name](sim.mesh) for name in trial.probes])
    series.observe(sim)
    outcome = step_through(sim, [series], _reporter(tick), trial.seconds)
    if outcome.status == "interrupted":
        raise Interrupted(outcome.reason)
    numbers = series.numbers() | _costs(sim)
    fields = dict(sim.snapshot.fields) if outcome.completed else {}
    return Ended(outcome.status, outcome.reason or "", numbers, fields, sim.mesh)


def _reporter(tick: Tick | None) -> Callable[[Simulation], None] | None:
    if tick is None:
        return None
    return lambda sim: tick(f"day {sim.time / DAY:.3g}, step {sim.steps} of {sim.plan.steps}")


def _costs(sim: Simulation) -> dict[str, float]:
    costs = sim.stepper.costs()
    names = ("newton_iterations", "krylov_iterations", "rejected_steps")
    return {
        "dt": sim.plan.dt,
        "dt_over_gravity": sim.plan.dt / _gravity_limit(sim),
        "steps": float(sim.steps),
        "step_seconds": sim.wall_seconds,
        **{name: float(costs[name]) for name in names if name in costs},
    }


def line(error: Exception) -> str:
    """The message in one line."""
    return " ".join(str(error).split())
