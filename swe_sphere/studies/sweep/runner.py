"""Makes the runs of a sweep one after the other: stepped, timed, told in numbers, kept."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from swe_sphere.errors import ConfigError, RunFailed, in_one_line
from swe_sphere.io.integrals import DRIFTS
from swe_sphere.planet import DAY
from swe_sphere.simulation.diagnostics import DIAGNOSTICS, Snapshot
from swe_sphere.simulation.loop import Interruption
from swe_sphere.simulation.observers import Observer, Ticker
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.studies.ended import Ended, attempt, stepped
from swe_sphere.studies.peak_memory import begin_peak, peak_memory
from swe_sphere.studies.record_store import Store
from swe_sphere.studies.sweep.record import Errors, RunRecord, current
from swe_sphere.studies.sweep.runs import Discretisation, History, RunSpec
from swe_sphere.studies.sweep.watcher import SweepWatcher

COUNTS = (
    "rhs_evaluations", "tangent_evaluations", "preconditioner_applications",
    "newton_iterations", "krylov_iterations", "rejected_steps",
)  # fmt: skip

KEPT = ("u", "v", "h", "vorticity")
"""What is kept of a state to take errors of it."""

TIMES = ("wall_seconds", "cpu_seconds", "setup_seconds", "compile_seconds", "total_seconds")
"""What is not told of runs that were not alone."""

WARM_STEPS = 2
"""Steps before the clock runs: the second of a two-step method is its first real one."""


@dataclass
class Result(Ended):
    """What a run came to: costs and, if it was completed, drifts and the user's own diagnostics."""

    snapshots: History = field(default_factory=dict)
    """Fields at the report days that were reached."""


class Snapshots(Observer):
    """An observer that keeps the fields at report days."""

    def __init__(self, days: dict[int, float]) -> None:
        self._days = days
        self.kept: History = {}

    def due(self, step: int) -> bool:
        """At the report days."""
        return step in self._days

    def observe(self, snapshot: Snapshot) -> None:
        """Keep the fields."""
        if snapshot.steps in self._days:
            fields = snapshot.all_fields
            self.kept[self._days[snapshot.steps]] = {name: fields[name] for name in KEPT}


def execute(
    spec: RunSpec,
    interruption: Interruption,
    time_limit: float | None = None,
    tick: Callable[[int], None] | None = None,
) -> Result:
    """Run to the end, or to where it fails; the steps alone are on the clock.

    Raises:
        Interrupted: the user asked to stop.
    """
    begin_peak()
    began = time.perf_counter()
    try:
        sim = _begun(spec)
    except (ConfigError, RunFailed) as error:
        return Result("refused", in_one_line(error))
    snapshots = Snapshots(spec.report_steps())
    observers = [snapshots, *([] if tick is None else [Ticker(tick)])]
    ended = stepped(sim, observers, time_limit, interruption)
    result = Result(ended.status, ended.reason, _costs(sim), snapshots=snapshots.kept)
    result.numbers |= _diagnostics(sim) if ended.completed else {}
    result.numbers |= {"peak_memory": peak_memory(), "total_seconds": time.perf_counter() - began}
    return result


def warm_up(spec: RunSpec) -> float:
    """Take a few steps, so that kernels are compiled and caches filled; seconds of compiling.

    What fails here fails again in the run, where it is told.
    """

    def work() -> Ended:
        sim = _begun(spec)
        for _ in range(WARM_STEPS):
            sim.step()
        return Ended(numbers={"compile_seconds": sim.model.compile_seconds})

    return attempt(work).numbers.get("compile_seconds", math.nan)


def _begun(spec: RunSpec) -> Simulation:
    """The simulation at its start."""
    if spec.refusal is not None:
        raise ConfigError(spec.refusal)
    sim = spec.space.simulation(spec.config)
    sim.begin(spec.steps)
    return sim


def _costs(sim: Simulation) -> dict[str, float]:
    counts = sim.counts()
    return {
        **{name: counts.get(name, 0) for name in (*COUNTS, "setup_seconds")},
        "steps": sim.steps,
        "days": sim.steps * sim.plan.dt / DAY,
        "wall_seconds": sim.clock.wall_seconds,
        "cpu_seconds": sim.clock.cpu_seconds,
        "compile_seconds": sim.model.compile_seconds,
    }


def _diagnostics(sim: Simulation) -> dict[str, float]:
    """Drifts, and those of the user's own diagnostics that are numbers."""
    found = sim.diagnostics
    return {name: found[name] for name in (*DRIFTS, *DIAGNOSTICS) if name in found}


TakeErrors = Callable[[Discretisation, History], list[Errors]]
"""Takes the errors of the fields at report days."""


@dataclass
class Runner:
    """Makes runs; every one ends as a record in the store before the next begins."""

    store: Store[RunRecord]
    sources: dict[str, str]
    """Of what all runs are made; records of others are not known here."""
    interruption: Interruption
    watcher: SweepWatcher
    time_limit: float | None
    """Wall time of the steps of a run [s]."""
    jobs: int = 1
    """How many processes are at work beside each other."""

    def __post_init__(self) -> None:
        runs = current(self.store.records, self.sources)
        self._known = {(run.key, run.repeat): run for run in runs}
        self._warm: set[object] = set()
        self.spent = 0.0
        """Wall time of the steps of all runs made here [s]."""

    def known(self, spec: RunSpec, repeat: int = 0) -> RunRecord | None:
        """The record of a run that need not be made again.

        One that ran out of time counts only if it would again.
        """
        record = self._known.get((spec.key, repeat))
        if record is None or record.status != "timed-out":
            return record
        had, has = record.time_limit, self.time_limit
        return record if has is not None and had is not None and has <= had else None

    def timings(self, spec: RunSpec) -> list[float]:
        """Times of the completed repeats of a run that were alone [s], the shortest first."""
        repeats = (run for (key, _), run in self._known.items() if key == spec.key)
        completed = (run.seconds for run in repeats if run.status == "completed")
        return sorted(filter(math.isfinite, completed))

    def repeats(self, spec: RunSpec) -> int:
        """Number of records of a run."""
        return sum(key == spec.key for key, _ in self._known)

    def run(self, spec: RunSpec, evaluate: TakeErrors | None = None, repeat: int = 0) -> RunRecord:
        """The record of a run: the known one, or that of a new run.

        evaluate: takes its errors.

        Raises:
            Interrupted: the user asked to stop.
            RunFailed: the record cannot be written.
        """
        record = self.known(spec, repeat)
        if record is None:
            result = self.result(spec, self.time_limit)
            errors = evaluate(spec.space, result.snapshots) if evaluate else []
            record = self.keep(spec, result, errors, repeat)
        self.watcher.done(spec, record)
        return record

    def result(self, spec: RunSpec, time_limit: float | None = None) -> Result:
        """Make a run, warm."""
        self.interruption.check()
        self.watcher.begin(spec)
        compiled = self._warmed(spec)
        result = execute(spec, self.interruption, time_limit, self.watcher.tick)
        self.spent += result.numbers.get("wall_seconds", 0.0)
        if "compile_seconds" in result.numbers:
            result.numbers["compile_seconds"] += compiled
        return result

    def keep(
        self, spec: RunSpec, result: Result, errors: list[Errors], repeat: int = 0
    ) -> RunRecord:
        """Write the record of a run."""
        untold = dict.fromkeys(TIMES if self.jobs > 1 else ())
        return self.take(RunRecord(
            key=spec.key, repeat=repeat, role=spec.role, config=spec.resolved,
            status=result.status, reason=result.reason,
            numbers=result.numbers | spec.space.limits | untold,
            errors=errors, time_limit=self.time_limit,
            sources=self.sources | spec.integrator.sources, jobs=self.jobs,
        ))  # fmt: skip

    def take(self, record: RunRecord) -> RunRecord:
        """Write a record that was made here or by another process."""
        kept = self._known[record.key, record.repeat] = self.store.add(record)
        return kept

    def _warmed(self, spec: RunSpec) -> float:
        """Seconds of compiling for this kind of run, in the first of which it is done."""
        if spec.integrator.identity in self._warm or spec.refusal is not None:
            return 0.0
        self._warm.add(spec.integrator.identity)
        return warm_up(spec)
