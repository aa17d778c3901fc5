"""One run of a sweep: stepped, timed, and told in numbers whatever becomes of it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from swe_sphere.errors import ConfigError, RunFailed, TimedOut, Unstable
from swe_sphere.io.diagnostics import drifts
from swe_sphere.planet import DAY
from swe_sphere.simulation.health import HealthCheck
from swe_sphere.simulation.interrupt import Interruption
from swe_sphere.simulation.loop import Loop
from swe_sphere.simulation.snapshot import Moment
from swe_sphere.studies.sweep.bench import FIELDS, Fields
from swe_sphere.studies.sweep.case import Case
from swe_sphere.studies.sweep.memory import begin_peak, peak_memory

if TYPE_CHECKING:
    from swe_sphere.equations.model import Model
    from swe_sphere.steppers import Stepper

__all__ = ["COUNTS", "Outcome", "execute", "warm_up"]

COUNTS = (
    "rhs_evaluations", "tangent_evaluations", "preconditioner_applications",
    "newton_iterations", "krylov_iterations", "rejected_steps",
)  # fmt: skip

BREAKDOWNS = (ArithmeticError, ValueError, MemoryError)
"""What libraries raise when they are given a state that makes no sense, or too large a problem."""

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

    def observe(self, moment: Moment) -> None:
        """Keep the fields."""
        self.last = moment.all_fields
        if moment.step in self._days:
            self.kept[self._days[moment.step]] = {name: self.last[name] for name in FIELDS}


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
    outcome = Outcome()
    begin_peak()
    began = time.perf_counter()
    try:
        model, stepper = _built(case)
    except (ConfigError, RunFailed) as error:
        return Outcome("refused", _line(error))
    assert case.steps is not None
    start = case.bench.start
    health = HealthCheck(model, start, f"dt = {case.dt:.6g} s")
    days = case.schedule.report_steps(case.steps) if case.judged else {}
    snapshots = Snapshots(days)
    loop = Loop(model, stepper, case.steps, health, [snapshots], tick, time_limit)
    with np.errstate(all="ignore"):
        outcome.status, outcome.reason = _run(loop, interruption)
    outcome.snapshots = snapshots.kept
    outcome.numbers = _numbers(case, model, stepper, loop)
    if outcome.status == "completed":
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
        model, stepper = _built(case)
        with np.errstate(all="ignore"):
            for _ in range(WARM_STEPS):
                stepper.step()
    except (ConfigError, RunFailed, *BREAKDOWNS):
        return math.nan
    return model.compile_seconds


def _built(case: Case) -> tuple[Model, Stepper]:
    from swe_sphere.steppers import get_stepper

    if case.refusal is not None:
        raise ConfigError(case.refusal)
    bench, kind = case.bench, get_stepper(case.config.stepper)
    model = bench.model()
    stepper = kind(model, case.dt, **bench.options(case.config))
    stepper.start(model.initial_state())
    return model, stepper


def _run(loop: Loop, interruption: Interruption) -> tuple[str, str]:
    """How it ended, by name and in words."""
    try:
        loop.run(interruption)
    except Unstable as error:
        return "unstable", _line(error)
    except TimedOut as error:
        return "timed-out", _line(error)
    except RunFailed as error:
        return "solver-failed", _line(error)
    except BREAKDOWNS as error:
        return "solver-failed", f"{type(error).__name__}: {_line(error)}"
    return "completed", ""


def _numbers(case: Case, model: Model, stepper: Stepper, loop: Loop) -> dict[str, float]:
    costs: dict[str, Any] = dict(model.counters) | stepper.costs()
    done = stepper.steps
    return {
        **{name: costs.get(name, 0) for name in COUNTS},
        "setup_seconds": costs.get("setup_seconds", 0.0),
        "steps": done,
        "days": done * case.dt / DAY,
        "wall_seconds": loop.wall_seconds,
        "cpu_seconds": loop.cpu_seconds,
        "compile_seconds": model.compile_seconds,
    }


def _line(error: Exception) -> str:
    return " ".join(str(error).split())
