"""Running one trial: its steps, what is watched, and its numbers."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np

from swe_sphere.planet import DAY
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.simulation.time_plan import TimePlan
from swe_sphere.studies.ended import Ended, attempt, stepped
from swe_sphere.studies.stress.series import Series
from swe_sphere.studies.stress.symmetries import SYMMETRIES
from swe_sphere.studies.stress.trial import Trial

__all__ = ["Tick", "run_trial"]

Tick = Callable[[str], None]
COSTS = ("newton_iterations", "krylov_iterations", "rejected_steps")


def run_trial(trial: Trial, tick: Tick | None = None) -> Ended:
    """Make the run to its end or to where it fails, whatever happens.

    Raises:
        Interrupted: the user asked to stop.
    """
    began = time.perf_counter()
    ended = attempt(lambda: _watched(trial, tick))
    ended.numbers["seconds"] = time.perf_counter() - began
    return ended


def _watched(trial: Trial, tick: Tick | None) -> Ended:
    sim = trial.configuration.simulation()
    sim.begin(_plan(trial, sim))
    series = Series(sim.plan, [SYMMETRIES[name](sim.mesh) for name in trial.symmetries])
    series.observe(sim)
    ended = stepped(sim, [series], tick, trial.seconds)
    ended.numbers = series.numbers() | _costs(sim)
    return ended


def _plan(trial: Trial, sim: Simulation) -> TimePlan | None:
    """Steps as the trial has them; None: as an ordinary run chooses them."""
    if trial.part is None and trial.courant is None:
        return None
    own = trial.part is not None and math.isfinite(sim.stable_dt)
    dt = (trial.part or 1.0) * sim.stable_dt if own else _implicit_step(trial, sim)
    length = sim.days * DAY
    count = max(1, math.ceil(length / dt - 1e-9))
    if trial.steps is not None:
        whole = max(1, math.floor(length / dt))
        count = trial.steps if sim.config.days is None else min(trial.steps, whole)
    return TimePlan(dt, count, count, dt)


def _implicit_step(trial: Trial, sim: Simulation) -> float:
    """The step in gravity-wave limits [s], within the advective Courant number it may have."""
    dt = (trial.courant or 1.0) * sim.gravity_limit
    if trial.advective is None:
        return dt
    wind = float(np.hypot(sim.start["u"], sim.start["v"]).max())
    return min(dt, trial.advective * sim.mesh.spacing()[0] / wind) if wind > 0.0 else dt


def _costs(sim: Simulation) -> dict[str, float]:
    costs = sim.stepper.costs()
    return {
        "dt": sim.plan.dt,
        "dt_over_gravity": sim.plan.dt / sim.gravity_limit,
        "steps": float(sim.steps),
        "step_seconds": sim.wall_seconds,
        **{name: float(costs[name]) for name in COSTS if name in costs},
    }
