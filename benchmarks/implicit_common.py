"""What the sections of the page on implicit steppers share: runs and timings."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from threadpoolctl import threadpool_limits

from swe_sphere.equations import Model
from swe_sphere.io.integrals import integrals
from swe_sphere.planet import DAY
from swe_sphere.steppers import get_stepper

DAYS = 15.0
MOUNTAIN = (1.5 * np.pi, np.pi / 6.0)


@dataclass
class Section:
    """One table of the page."""

    title: str
    note: str
    columns: list[str]
    rows: list[list[str]]
    figure: str = ""
    """File beside the page, if there is one."""


@dataclass
class Run:
    """What one run cost and where it ended."""

    model: Model
    stepper: Any
    seconds: float
    """Wall time of the steps [s]."""
    cpu_seconds: float
    rhs_seconds: float
    """CPU time of one right-hand side [s], from before and after the run."""
    fields: dict[str, np.ndarray]
    energy_drift: list[float]
    """Relative change of energy since the start, each day."""

    @property
    def counts(self) -> str:
        """Newton and Krylov iterations a step."""
        steps, counters = self.stepper.steps, self.stepper.counters
        newton = counters.get("newton_iterations", 0) / steps
        return f"{newton:.1f} / {counters.get('krylov_iterations', 0) / steps:.1f}"


def run(model: Model, name: str, dt: float, days: float, **options: Any) -> Run:
    """Run a stepper from the scene's initial state; the time for the energies does not count."""
    stepper = get_stepper(name)(model, dt, **options)
    start = model.initial_state()
    stepper.start(start)
    rhs = [_rhs_seconds(model)]
    wall = cpu = 0.0
    drift = []
    for day in range(1, max(round(days), 1) + 1):
        began, began_cpu = time.perf_counter(), time.process_time()
        while stepper.time < min(day, days) * DAY - 0.5 * dt:
            stepper.step()
        wall += time.perf_counter() - began
        cpu += time.process_time() - began_cpu
        energies = [_energy(model, state) for state in (start, stepper.state)]
        drift.append(energies[1] / energies[0] - 1.0)
    rhs.append(_rhs_seconds(model))
    return Run(model, stepper, wall, cpu, float(np.mean(rhs)), model.fields(stepper.state), drift)


def _rhs_seconds(model: Model) -> float:
    """CPU time of one right-hand side [s]: the median of batches."""
    state, out = model.initial_state(), model.zeros()
    [seconds] = interleaved(
        lambda: model.tendency(state, 0.0, out), rounds=10, batch=30, clock=time.process_time
    )
    return seconds


def interleaved(
    *calls: Callable[[], None],
    rounds: int = 15,
    batch: int = 10,
    clock: Callable[[], float] = time.perf_counter,
) -> list[float]:
    """Median seconds of each call, measured in turns."""
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


def _energy(model: Model, state: wp.array) -> float:
    fields = model.fields(state)
    found = integrals(
        model.mesh, model.scene.planet, fields["u"], fields["v"], fields["h"], model.bottom
    )
    return found["energy"]
