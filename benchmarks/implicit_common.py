"""Runs and timings that the sections of the page on implicit steppers share."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from swe_sphere.equations.model import Model
from swe_sphere.errors import RunFailed
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY
from swe_sphere.simulation.diagnostics import Snapshot
from swe_sphere.simulation.observers import Observer
from swe_sphere.simulation.planning import RunPlan
from swe_sphere.simulation.simulation import Simulation

DAYS = 15.0
MOUNTAIN = (270.0, 30.0)
"""Longitude and latitude [degrees] of the mountain of williamson5."""


@dataclass
class Run:
    """Cost and final state of one run."""

    sim: Simulation
    rhs_seconds: float
    """CPU time of one right-hand side [s]: mean of measurements before and after the run."""
    energy_drift: list[float]
    """Relative change of energy since the initial state, once a day."""

    @property
    def counts(self) -> str:
        """Newton and Krylov iterations per step, as text."""
        steps, counters = self.sim.steps, self.sim.stepper.counters
        newton = counters.get("newton_iterations", 0) / steps
        return f"{newton:.1f} / {counters.get('krylov_iterations', 0) / steps:.1f}"


def run(scene: str, mesh: Mesh, name: str, dt: float, days: float, **options: Any) -> Run:
    """Run the stepper `name` with steps of dt [s]; energy diagnostics are not timed."""
    steps = math.ceil(days * DAY / dt - 1e-9)
    sim = Simulation(scene, mesh=mesh, stepper=name, options=options)
    sim.begin(RunPlan(dt, steps, steps, dt))
    rhs, daily = [_rhs_seconds(sim.model)], Energies(max(1, round(DAY / dt)))
    outcome = sim.run_plan([daily])
    if not outcome.completed:
        raise RunFailed(outcome.reason)
    rhs.append(_rhs_seconds(sim.model))
    return Run(sim, float(np.mean(rhs)), daily.drifts)


@dataclass
class Energies(Observer):
    """Records the relative change of energy about once a day, and at the end."""

    every: int
    drifts: list[float] = field(default_factory=list)

    def due(self, step: int) -> bool:
        """Return True about once a day."""
        return step % self.every == 0

    def observe(self, snapshot: Snapshot) -> None:
        """Record the relative change of energy."""
        self.drifts.append(snapshot.diagnostics["energy_drift"])


def _rhs_seconds(model: Model) -> float:
    """Return the CPU time of one right-hand side [s]: the median of batches."""
    state, out, counted = model.initial_state(), model.zeros(), dict(model.counters)
    [seconds] = interleaved(
        lambda: model.tendency(state, 0.0, out), rounds=10, batch=30, clock=time.process_time
    )
    model.counters.update(counted)
    return seconds


def interleaved(
    *calls: Callable[[], None],
    rounds: int = 15,
    batch: int = 10,
    clock: Callable[[], float] = time.perf_counter,
) -> list[float]:
    """Return the median time [s] of each call; the calls are measured in turns."""
    seconds: list[list[float]] = [[] for _ in calls]
    with threadpool_limits(1, user_api="blas"):
        for _ in range(rounds):
            for times, call in zip(seconds, calls, strict=True):
                call()
                began = clock()
                for _ in range(batch):
                    call()
                times.append((clock() - began) / batch)
    return [float(np.median(times)) for times in seconds]
