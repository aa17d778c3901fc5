"""One run of a sweep: stepped, timed, and told in numbers whatever becomes of it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.io.integrals import drifts
from swe_sphere.planet import DAY
from swe_sphere.simulation.execution import BREAKDOWNS, step_through
from swe_sphere.simulation.interrupt import Interruption
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.simulation.supplied import Supplied
from swe_sphere.studies.sweep.bench import FIELDS, Fields
from swe_sphere.studies.sweep.case import Case
from swe_sphere.studies.sweep.memory import begin_peak, peak_memory

__all__ = ["COUNTS", "Outcome", "execute", "warm_up"]

COUNTS = (
    "rhs_evaluations", "tangent_evaluations", "preconditioner_applications",
    "newton_iterations", "krylov_iterations", "rejected_steps",
)  # fmt: skip

WARM_STEPS = 2
"""Steps before the clock runs: the second of a two-step method is its first real one."""


@dataclass
class Outcome:
    """What a run came to."""

    status: str = "completed"
    """completed, unstable, timed-out, solver-failed or refused."""
    reason: str = ""
    numbers: dict[str, float] = field(default_factory=dict)
    snapshots: dict[float, Fields] = field(default_factory=dict)
    """Fields at the report days that were reached."""


class Snapshots:
    """An observer that keeps the fields at report days, and those of the last state."""

    def __init__(self, days: dict[int, float]) -> None:
        self._days = days
        self.kept: dict[float, Fields] = {}
        self.last: Fields = {}

    def due(self, step: int) -> bool:
        """At the report days."""
        return step in self._days

    def observe(self, sim: Simulation) -> None:
        """Keep the fields."""
        self.last = sim.snapshot.all_fields
        if sim.steps in self._days:
            self.kept[self._days[sim.steps]] = {name: self.last[name] for name in FIELDS}


def execute(
    case: Case,
    interruption: Interruption,
    time_limit: float | None = None,
    tick: Callable[[int], None] | None = None,
) -> Outcome:
    """Run a case to its end, or to where it fails; the steps alone are on the clock.

    Raises:
        Interrupted: the user asked to stop.
    """
    begin_peak()
    began = time.perf_counter()
    try:
        sim = _built(case)
    except (ConfigError, RunFailed) as error:
        return Outcome("refused", _line(error))
    assert case.steps is not None
    days = case.schedule.report_steps(case.steps) if case.judged else {}
    snapshots = Snapshots(days)
    told = None if tick is None else (lambda sim: tick(sim.steps))
    with np.errstate(all="ignore"):
        ended = step_through(sim, [snapshots], told, time_limit, interruption)
    outcome = Outcome(ended.status, ended.reason or "", _numbers(sim), snapshots.kept)
    if ended.completed:
        outcome.numbers |= drifts(case.bench.integrals, case.bench.integrals_of(snapshots.last))
    outcome.numbers |= {
        "peak_memory": peak_memory(), "total_seconds": time.perf_counter() - began
    }  # fmt: skip
    return outcome


def warm_up(case: Case) -> float:
    """Take a few steps, so that kernels are compiled and caches filled; seconds of compiling.

    What fails here fails again in the run, where it is told.
    """
    try:
        sim = _built(case)
        with np.errstate(all="ignore"):
            for _ in range(WARM_STEPS):
                sim.step()
    except (ConfigError, RunFailed, *BREAKDOWNS):
        return math.nan
    return sim.model.compile_seconds


def _built(case: Case) -> Simulation:
    if case.refusal is not None:
        raise ConfigError(case.refusal)
    sim = Simulation.from_config(case.config, Supplied(mesh=case.bench.mesh))
    sim.begin(case.steps)
    return sim


def _numbers(sim: Simulation) -> dict[str, float]:
    costs = sim.counts()
    return {
        **{name: costs.get(name, 0) for name in COUNTS},
        "setup_seconds": costs.get("setup_seconds", 0.0),
        "steps": sim.steps,
        "days": sim.steps * sim.plan.dt / DAY,
        "wall_seconds": sim.wall_seconds,
        "cpu_seconds": sim.cpu_seconds,
        "compile_seconds": sim.model.compile_seconds,
    }


def _line(error: Exception) -> str:
    return " ".join(str(error).split())
