"""Running one trial: how it ended, in one word and in one line, and in numbers."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from swe_sphere.errors import SweError
from swe_sphere.planet import DAY
from swe_sphere.simulation.execution import step_through
from swe_sphere.simulation.interrupt import Interrupted
from swe_sphere.simulation.plan import TimePlan
from swe_sphere.simulation.running import Running
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.studies.stress.series import Series
from swe_sphere.studies.stress.symmetries import SYMMETRIES
from swe_sphere.studies.stress.trial import Trial

__all__ = ["Ended", "Tick", "attempt", "line"]

Tick = Callable[[str], None]
COSTS = ("newton_iterations", "krylov_iterations", "rejected_steps")


@dataclass
class Ended:
    """How a run ended."""

    status: str = "completed"
    """As `Summary.status`."""
    reason: str = ""
    numbers: dict[str, float] = field(default_factory=dict)
    sim: Simulation | None = None
    """The run, at its end."""


def attempt(trial: Trial, tick: Tick | None = None) -> Ended:
    """Make the run to its end or to where it fails, whatever happens.

    Raises:
        Interrupted: the user asked to stop.
    """
    began = time.perf_counter()
    try:
        with np.errstate(all="ignore"):
            ended = _stepped(trial, tick)
    except SweError as error:
        ended = Ended(error.status, line(error))
    except (
        ArithmeticError,
        LookupError,
        MemoryError,
        RuntimeError,
        TypeError,
        ValueError,
    ) as error:
        ended = Ended("failed", f"{type(error).__name__}: {line(error)}")
    ended.numbers["seconds"] = time.perf_counter() - began
    return ended


def _stepped(trial: Trial, tick: Tick | None) -> Ended:
    sim = trial.configuration.simulation()
    sim.begin(_plan(trial, sim))
    series = Series(sim.plan, [SYMMETRIES[name](sim.mesh) for name in trial.symmetries])
    series.observe(sim)
    outcome = step_through(sim, [series], _reporter(tick), trial.seconds)
    if outcome.status == "interrupted":
        raise Interrupted(outcome.reason)
    return Ended(outcome.status, line(outcome.reason or ""), series.numbers() | _costs(sim), sim)


def _reporter(tick: Tick | None) -> Callable[[Running], None] | None:
    if tick is None:
        return None
    return lambda sim: tick(f"day {sim.time / DAY:.3g}, step {sim.steps} of {sim.plan.steps}")


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
    dt = (trial.courant or 1.0) * _gravity_limit(sim)
    if trial.advective is None:
        return dt
    wind = float(np.hypot(sim.start["u"], sim.start["v"]).max())
    return min(dt, trial.advective * sim.mesh.spacing()[0] / wind) if wind > 0.0 else dt


def _gravity_limit(sim: Simulation) -> float:
    """1 over the spectral radius at the start [s]."""
    radius = sim.model.spectrum(sim.model.initial_state()).wave
    return 1.0 / radius if radius > 0.0 else math.inf


def _costs(sim: Simulation) -> dict[str, float]:
    costs = sim.stepper.costs()
    return {
        "dt": sim.plan.dt,
        "dt_over_gravity": sim.plan.dt / _gravity_limit(sim),
        "steps": float(sim.steps),
        "step_seconds": sim.wall_seconds,
        **{name: float(costs[name]) for name in COSTS if name in costs},
    }


def line(text: object) -> str:
    """The text in one line."""
    return " ".join(str(text).split())
