"""Makes the runs of a sweep one after the other: stepped, timed, told in numbers, kept."""

import gc
import math
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from swe_sphere.errors import ConfigError, RunFailed, SweError, in_one_line
from swe_sphere.io.integrals import DRIFTS
from swe_sphere.planet import DAY
from swe_sphere.simulation.diagnostics import DIAGNOSTICS, Snapshot
from swe_sphere.simulation.loop import Interruption
from swe_sphere.simulation.observers import Observer, Ticker
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.simulation.summary import Summary
from swe_sphere.studies.ended import BREAKDOWNS, stepped
from swe_sphere.studies.record_store import Store
from swe_sphere.studies.sweep.record import COUNTS, Errors, RunRecord, current
from swe_sphere.studies.sweep.runs import Discretisation, History, Integrator, RunSpec
from swe_sphere.studies.sweep.steps import GROWN, GROWTH_OF_FLOW, PERTURBATION

KEPT = ("u", "v", "h", "vorticity")
"""Fields of a state of which errors are taken."""
TIMES = ("wall_seconds", "cpu_seconds", "setup_seconds", "compile_seconds", "total_seconds")
"""Numbers that are not told of runs that were not alone."""
WARM_STEPS = 2
"""Steps before the clock runs: the second of a two-step method is its first real one."""


class SweepWatcher:
    """Progress of a sweep on stderr: notes, and a bar if that is a terminal; by default nothing."""

    def __init__(self, title: str = "", quiet: bool = True) -> None:
        from tqdm import tqdm

        self._quiet, self._label, self._steps = quiet, "", 0
        self._bar: Any = tqdm(
            total=0, desc=title, unit="run", leave=False, file=sys.stderr,
            disable=quiet or not sys.stderr.isatty(),
        )  # fmt: skip
        self.close = self._bar.close

    def expect(self, runs: int) -> None:
        """Lengthen the bar by a number of runs."""
        self._bar.total += runs
        self._bar.refresh()

    def begin(self, spec: RunSpec) -> None:
        """Show which run is about to begin."""
        self._label, self._steps = spec.label, spec.steps.steps if spec.steps else 0
        self._bar.set_postfix_str(spec.label)

    def tick(self, step: int) -> None:
        """Show the number of its steps so far; called about ten times a second."""
        self._bar.set_postfix_str(f"{self._label}, step {step} of {self._steps}")

    def done(self) -> None:
        """Move the bar: a run is finished, or was known."""
        self._bar.update()

    def note(self, text: str) -> None:
        """Print a line for the user."""
        if not self._quiet:
            self._bar.write(text, file=sys.stderr)


class Snapshots(Observer):
    """Keeps the fields after some steps, by the report days of these."""

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
    spec: RunSpec, interruption: Interruption, time_limit: float | None, tick: Callable[[int], None]
) -> tuple[Summary, History]:
    """Run to the end, or to where it fails; the steps alone are on the clock.

    Returns how it ended, with costs and, if it was completed, drifts and the user's own
    diagnostics; and the fields at the report days that were reached.

    Raises:
        Interrupted: the user asked to stop.
    """
    gc.collect()  # memory of earlier runs
    began = time.perf_counter()
    try:
        sim = _begun(spec)
    except (ConfigError, RunFailed) as error:
        return Summary("refused", in_one_line(error)), {}
    snapshots = Snapshots({round(day * DAY / spec.dt): day for day in spec.report_days})
    ended = stepped(sim, [snapshots, Ticker(tick)], time_limit, interruption)
    counts = sim.counts()
    if ended.completed and spec.role == "stability":
        ended = perturbed(spec, sim, interruption, time_limit)
    ended.numbers.update({
        **{name: counts.get(name, 0) for name in (*COUNTS, "setup_seconds")},
        "steps": sim.steps, "days": sim.steps * sim.plan.dt / DAY,
        "wall_seconds": sim.wall_seconds, "cpu_seconds": sim.cpu_seconds,
        "compile_seconds": sim.model.compile_seconds,
    })  # fmt: skip
    if ended.completed:
        found = sim.diagnostics
        own = {name: found[name] for name in (*DRIFTS, *DIAGNOSTICS) if name in found}
        ended.numbers.update(own)
    ended.numbers["total_seconds"] = time.perf_counter() - began
    return ended, snapshots.kept


def perturbed(
    spec: RunSpec, sim: Simulation, interruption: Interruption, time_limit: float | None
) -> Summary:
    """Repeat a run from its initial state with noise; it is unstable where the noise grows.

    sim: the run, at its end.
    """
    from swe_sphere.steppers.stage_solver import energy_weights  # imports Warp

    twin = _begun(spec)
    model, mesh = twin.model, twin.model.device_mesh
    start = mesh.collect(twin.stepper.state).astype(float)
    blocks = start.reshape(len(model.names), -1)
    scales = np.abs(blocks).max(axis=1, keepdims=True)
    size = max(PERTURBATION, 100.0 * float(np.finfo(mesh.numpy_real).eps))
    noise = size * scales * np.random.default_rng(1).standard_normal(blocks.shape)
    twin.stepper.start(mesh.scatter(start + noise.ravel()))
    ended = stepped(twin, (), time_limit, interruption)
    if not ended.completed:
        return ended
    states = [mesh.collect(one.stepper.state).astype(float) for one in (twin, sim)]
    squares = [energy_weights(model) @ x**2 for x in (noise.ravel(), states[0] - states[1])]
    growth, days = math.sqrt(squares[1] / squares[0]), sim.time / DAY
    if growth <= GROWN * math.exp(min(GROWTH_OF_FLOW * days, 600.0)):
        return ended
    return Summary("unstable", f"noise has grown {growth:.3g} times in {days:.4g} days")


def warm_up(spec: RunSpec) -> float:
    """Take a few steps, so that kernels are compiled and caches filled; seconds of compiling.

    What fails here fails again in the run, where it is told.
    """
    with suppress(SweError, *BREAKDOWNS), np.errstate(all="ignore"):
        sim = _begun(spec)
        for _ in range(WARM_STEPS):
            sim.step()
        return sim.model.compile_seconds
    return math.nan


def _begun(spec: RunSpec) -> Simulation:
    """The simulation at its start."""
    if spec.refusal is not None:
        raise ConfigError(spec.refusal)
    sim = spec.integrator.space.simulation(spec.config)
    sim.begin(spec.steps)
    return sim


class Runner:
    """Makes runs; every one ends as a record in the store before the next begins.

    sources: of what all runs are made; records of others are not known here.  time_limit: wall time
    of the steps of a run [s].  jobs: how many processes are at work beside each other.
    """

    def __init__(
        self,
        store: Store[RunRecord],
        sources: dict[str, str],
        watcher: SweepWatcher,
        time_limit: float | None,
        jobs: int,
    ) -> None:
        self._sources, self._watcher, self._jobs = sources, watcher, jobs
        self.time_limit = time_limit
        self.read(store)
        self._warm: set[Integrator] = set()
        self.interruption = Interruption()
        self.spent = 0.0
        """Wall time of the steps of all runs made here [s]."""

    def read(self, store: Store[RunRecord]) -> None:
        """Take the runs of a store for known, and keep new ones there."""
        self._store = store
        runs = current(store.records, self._sources)
        self._known = {(run.key, run.repeat): run for run in runs}

    def known(self, spec: RunSpec, repeat: int = 0) -> RunRecord | None:
        """The record of a run that need not be made again.

        One that ran out of time counts only if it would again.
        """
        record = self._known.get((spec.key, repeat))
        if record is None or record.status != "timed-out":
            return record
        had, has = record.time_limit, self.time_limit
        return record if has is not None and had is not None and has <= had else None

    def repeats(self, spec: RunSpec) -> list[RunRecord]:
        """The records of a run."""
        return [run for (key, _), run in self._known.items() if key == spec.key]

    def run(
        self,
        spec: RunSpec,
        evaluate: Callable[[Discretisation, History], list[Errors]] | None = None,
        repeat: int = 0,
    ) -> RunRecord:
        """The record of a run: the known one, or that of a new run.

        evaluate: takes its errors.

        Raises:
            Interrupted: the user asked to stop.
            RunFailed: the record cannot be written.
        """
        record = self.known(spec, repeat)
        if record is None:
            record, fields = self.make(spec, self.time_limit, repeat)
            errors = evaluate(spec.integrator.space, fields) if evaluate else []
            record = self.keep(record.model_copy(update={"errors": errors}))
        self._watcher.done()
        return record

    def make(
        self, spec: RunSpec, time_limit: float | None = None, repeat: int = 0
    ) -> tuple[RunRecord, History]:
        """Make a run, warm: its record, yet without errors, and its fields at the report days."""
        self.interruption.check()
        self._watcher.begin(spec)
        compiled = 0.0
        if spec.integrator not in self._warm and spec.refusal is None:
            self._warm.add(spec.integrator)
            compiled = warm_up(spec)
        ended, fields = execute(spec, self.interruption, time_limit, self._watcher.tick)
        numbers = ended.numbers
        self.spent += numbers.get("wall_seconds", 0.0)
        if "compile_seconds" in numbers:
            numbers["compile_seconds"] += compiled
        untold = dict.fromkeys(TIMES if self._jobs > 1 else ())
        record = RunRecord(
            key=spec.key, repeat=repeat, role=spec.role, config=spec.resolved,
            status=ended.status, reason=ended.reason or "",
            numbers=numbers | spec.integrator.space.limits | untold, errors=[],
            time_limit=self.time_limit, sources=self._sources | spec.integrator.sources,
            jobs=self._jobs,
        )  # fmt: skip
        return record, fields

    def keep(self, record: RunRecord) -> RunRecord:
        """Write a record."""
        kept = self._known[record.key, record.repeat] = self._store.add(record)
        return kept
