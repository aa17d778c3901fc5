"""Run the runs of a sweep one after the other, store them, and compute their errors.

These are time errors (relative to a time-converged run), total errors and slow-flow errors.
"""

import gc
import math
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import cache, lru_cache, partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from tqdm import tqdm

from swe_sphere.errors import ConfigError, RunFailed, SweError, in_one_line
from swe_sphere.files.durable import write_whole
from swe_sphere.io.integrals import DRIFTS, Fields, Norms
from swe_sphere.io.reference_solution import OnGrid, Reference
from swe_sphere.operators.diagnose import vorticity
from swe_sphere.planet import DAY
from swe_sphere.simulation import diagnostics
from swe_sphere.simulation.loop import Interruption
from swe_sphere.simulation.observers import Observer, Ticker
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.simulation.summary import Summary
from swe_sphere.steppers.stage_solver import energy_weights
from swe_sphere.studies.record_store import UNEXPECTED, Store, as_netcdf, stepped
from swe_sphere.studies.sweep.record import COMPARED, COUNTS, Errors, RunRecord, current
from swe_sphere.studies.sweep.runs import Discretisation, History, RunSpec, Setup, Study

KEPT = ("u", "v", "h", "vorticity")
"""Fields of a state whose errors are computed."""
TIMES = ("wall_seconds", "cpu_seconds", "setup_seconds", "compile_seconds", "total_seconds")
"""Numbers that the records of parallel runs omit."""
WARM_STEPS = 2
"""Untimed steps at the start: the second step of a two-step method is its first regular one."""
PERTURBATION = 1e-7
"""Size of the noise that must not grow in a trial, relative to the largest value of a field."""
GROWN, GROWTH_OF_FLOW = 10.0, 0.5
"""A stable step amplifies noise by at most the first factor, times e to the second per day."""


class SweepWatcher:
    """Progress of a sweep on stderr: notes, and a bar if that is a terminal; by default nothing."""

    def __init__(self, title: str = "", quiet: bool = True) -> None:
        self._quiet, self._label, self._steps = quiet, "", 0
        self.completed = False
        """True if a run of the request, not one of its references, has reached its end."""
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
        self._label, self._steps = spec.label, spec.plan.steps if spec.plan else 0
        self._bar.set_postfix_str(spec.label)

    def tick(self, step: int) -> None:
        """Show the number of steps of the run so far; called about ten times a second."""
        self._bar.set_postfix_str(f"{self._label}, step {step} of {self._steps}")

    def done(self) -> None:
        """Advance the bar: a run is finished or was stored already."""
        self._bar.update()

    def note(self, text: str) -> None:
        """Print a line for the user."""
        if not self._quiet:
            self._bar.write(text, file=sys.stderr)


class Snapshots(Observer):
    """Keeps the fields at report days, given as days by number of steps."""

    def __init__(self, days: dict[int, float]) -> None:
        self._days = days
        self.kept: History = {}

    def due(self, step: int) -> bool:
        return step in self._days

    def observe(self, snapshot: diagnostics.Snapshot) -> None:
        if snapshot.steps in self._days:
            fields = snapshot.all_fields
            self.kept[self._days[snapshot.steps]] = {name: fields[name] for name in KEPT}


def run_timed(
    spec: RunSpec, interruption: Interruption, time_limit: float | None, tick: Callable[[int], None]
) -> tuple[Summary, History]:
    """Run to the end or to a failure, timing only the steps.

    Returns how it ended, with costs and, if it completed, drifts and user-defined diagnostics; and
    the fields at the report days that were reached. Raises Interrupted if the user asked to stop.
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
        "compile_seconds": sim.model.launch.compile_seconds,
    })  # fmt: skip
    if ended.completed:
        found = sim.diagnostics
        own = {name: found[name] for name in (*DRIFTS, *diagnostics.DIAGNOSTICS) if name in found}
        ended.numbers.update(own)
    ended.numbers["total_seconds"] = time.perf_counter() - began
    return ended, snapshots.kept


def perturbed(
    spec: RunSpec, sim: Simulation, interruption: Interruption, time_limit: float | None
) -> Summary:
    """Repeat `sim`, at its end, with initial noise; unstable if the noise grows beyond `GROWN`."""
    twin = _begun(spec)
    model, mesh = twin.model, twin.model.device_mesh
    start = mesh.collect(twin.stepper.state).astype(float)
    blocks = start.reshape(len(model.names), -1)
    scales = np.abs(blocks).max(axis=1, keepdims=True)
    size = max(PERTURBATION, 100.0 * float(np.finfo(mesh.numpy_real).eps))
    noise = size * scales * np.random.default_rng(1).standard_normal(blocks.shape)
    twin.stepper.start(mesh.scatter(start + noise.ravel()))
    if not (ended := stepped(twin, (), time_limit, interruption)).completed:
        return ended
    states = [mesh.collect(one.stepper.state).astype(float) for one in (twin, sim)]
    squares = [energy_weights(model) @ x**2 for x in (noise.ravel(), states[0] - states[1])]
    growth, days = math.sqrt(squares[1] / squares[0]), sim.time / DAY
    if growth <= GROWN * math.exp(min(GROWTH_OF_FLOW * days, 600.0)):
        return ended
    return Summary("unstable", f"noise has grown {growth:.3g} times in {days:.4g} days")


def warm_up(spec: RunSpec) -> float:
    """Take some steps to compile kernels and fill caches; return the seconds of compiling.

    Errors here recur in the run, which reports them.
    """
    with suppress(SweError, *UNEXPECTED), np.errstate(all="ignore"):
        sim = _begun(spec)
        for _ in range(WARM_STEPS):
            sim.step()
        return sim.model.launch.compile_seconds
    return math.nan


def _begun(spec: RunSpec) -> Simulation:
    """Return the started simulation of a run; ConfigError if the run is known to be impossible."""
    if spec.refusal is not None:
        raise ConfigError(spec.refusal)
    sim = spec.setup.space.simulation(spec.config)
    sim.begin(spec.plan)
    return sim


class Runner:
    """Runs the runs; each is stored as a record before the next begins, reference runs in pairs.

    study: the request; records of other sources are ignored. jobs: number of parallel processes.
    """

    def __init__(
        self, study: Study, store: Store[RunRecord], watcher: SweepWatcher, jobs: int
    ) -> None:
        self._sources, self._watcher, self._jobs = study.sources, watcher, jobs
        self.time_limit = study.plan.time_limit
        """Wall time of the steps of a run [s]."""
        self.read(store)
        self._warm: set[Setup] = set()
        self.interruption = Interruption()
        self.spent = 0.0
        """Wall time of the steps of all new runs [s]."""

    def read(self, store: Store[RunRecord]) -> None:
        """Read the stored runs as known ones, and store new ones there."""
        self._store = store
        self._known = {(run.key, run.repeat): run for run in current(store.records, self._sources)}

    def known(self, spec: RunSpec, repeat: int = 0) -> RunRecord | None:
        """Return the record of a run that need not be repeated, or None.

        A run that exceeded the time limit counts only if it would exceed the present one too.
        """
        record = self._known.get((spec.key, repeat))
        if record is None or record.status == "failed" or record.reason.startswith("MemoryError"):
            return None
        if record.status != "timed-out":
            return record
        had, has = record.time_limit, self.time_limit
        return record if has is not None and had is not None and has <= had else None

    @property
    def has_compared(self) -> bool:
        """True if the folder holds runs with errors relative to a reference."""
        return any(run.role in COMPARED for run in self._known.values())

    def repeats(self, spec: RunSpec) -> list[RunRecord]:
        """Return the records of a run."""
        return [run for (key, _), run in self._known.items() if key == spec.key]

    def run(
        self, spec: RunSpec,
        evaluate: Callable[[Discretisation, History], list[Errors]] | None = None, repeat: int = 0,
    ) -> RunRecord:  # fmt: skip
        """Return the record of a run, which is performed unless its record is known.

        evaluate: computes its errors. Raises Interrupted on request, RunFailed if the disk fails.
        """
        if (record := self.known(spec, repeat)) is None:
            record, fields = self.make(spec, self.time_limit, repeat)
            errors = evaluate(spec.setup.space, fields) if evaluate else []
            record = self.keep(record.model_copy(update={"errors": errors}))
        self._watcher.completed |= record.status == "completed" and spec.role in COMPARED
        self._watcher.done()
        return record

    def make(
        self, spec: RunSpec, time_limit: float | None = None, repeat: int = 0
    ) -> tuple[RunRecord, History]:
        """Warm up and run; return the record, without errors, and the fields at report days."""
        self.interruption.check()
        self._watcher.begin(spec)
        compiled = 0.0
        if spec.setup not in self._warm and spec.refusal is None:
            self._warm.add(spec.setup)
            compiled = warm_up(spec)
        ended, fields = run_timed(spec, self.interruption, time_limit, self._watcher.tick)
        numbers = ended.numbers
        self.spent += numbers.get("wall_seconds", 0.0)
        if "compile_seconds" in numbers:
            numbers["compile_seconds"] += compiled
        limit = {} if spec.setup.refusal else {"stable_dt": spec.setup.stable_dt}
        omitted = dict.fromkeys(TIMES if self._jobs > 1 else ())
        record = RunRecord(
            key=spec.key, repeat=repeat, role=spec.role, config=spec.resolved,
            status=ended.status, reason=ended.reason or "",
            numbers=numbers | spec.setup.space.limits | limit | omitted, errors=[],
            time_limit=time_limit, sources=self._sources | spec.setup.sources,
            jobs=self._jobs,
        )  # fmt: skip
        return record, fields

    def keep(self, record: RunRecord) -> RunRecord:
        """Store a record and return it in the form in which it is read."""
        kept = self._known[record.key, record.repeat] = self._store.add(record)
        return kept


CONVERGED = "converged"
"""Folder of the fields of reference runs."""
STEPPER, PART = "rk4", 0.25
"""Explicit stepper of the time-converged run, and its step as a fraction of the limit."""
RESOLVED, HALVINGS = 0.2, 2
"""Largest error of the time-converged run as a fraction of the smallest target, and the largest
number of times that its step is halved for it."""


class Evaluator:
    """Computes the errors of runs; reference runs are made when they are first needed.

    Reference runs have no time limit.  Their fields are kept in the folder and read again; if a
    reference run fails, its record contains the reason, and there are no fields.
    """

    def __init__(self, study: Study, runner: Runner, folder: Path) -> None:
        self._study, self._runner, self._folder = study, runner, folder / CONVERGED
        self._make = lru_cache(maxsize=1)(runner.make)  # a fine run is the next coarse one
        self._converged: dict[tuple[int, int], History] = {}
        self._errors = {"time": diagnostics.flow_errors}
        self._errors |= {"slow": diagnostics.slow_errors} if study.slow else {}
        self._right = cache(partial(_reference, study))

    def __call__(self, space: Discretisation, history: History) -> list[Errors]:
        """Return the errors of all kinds of the fields at report days."""
        apart = self._apart(space, history, self.converged(space))
        errors = self._total_errors(space, history)
        return errors + [each for kind in apart for each in Errors.of(kind, apart[kind])]

    def converged(self, space: Discretisation) -> History:
        """Return the fields at report days of a time-converged run on the same mesh in float64.

        A second run with twice the step yields the time errors of both runs by Richardson
        extrapolation; the records of both runs contain these errors and total errors. In a new
        folder steps are halved until the errors of a search are resolved; the reference then stays.
        """
        key = (space.mesh.ne, space.mesh.np)
        if key not in self._converged:
            study = self._study
            setup = study.setup(study.at(*key), STEPPER, settings=space.config.scene_settings)
            longest = min(2.0 * PART * setup.stable_dt, study.interval)
            twice = study.plan_steps(longest, automatic=True)
            plans = [
                replace(twice, dt=twice.dt / n, steps=n * twice.steps,
                        frame_steps=n * twice.frame_steps)
                for n in (2**halvings for halvings in range(HALVINGS + 2))
            ]  # fmt: skip
            best: RunSpec | None = None
            for pair in pairwise(plans):
                coarse, fine = (RunSpec(setup, x.dt, x, "converged", setup.refusal) for x in pair)
                if self._kept(fine) is None:
                    if best is not None and (self._runner.has_compared or self._resolves(best)):
                        break
                    self._compare(coarse, fine)
                best = fine
            self._converged[key] = (best and self._kept(best)) or {}
        return self._converged[key]

    def _resolves(self, spec: RunSpec) -> bool:
        """Return whether the error of a time-converged run is small beside those of a search."""
        record, plan = self._runner.known(spec), self._study.plan
        found = self._study.searched(record.errors) if record and plan.target_error else None
        if found is None or found.kind == "total":
            return True
        error: float | None = getattr(found, plan.target_norm)
        return error is None or error <= RESOLVED * min(plan.target_error)

    def _compare(self, coarse: RunSpec, fine: RunSpec) -> None:
        """Make both runs, and store time errors from their difference."""
        made = {spec: self._make(spec) for spec in (coarse, fine)}
        ours, right = (fields for _, fields in made.values())
        setup, space = fine.setup, fine.setup.space
        apart = self._apart(space, ours, right)
        gain = 2.0 ** setup.stepper_class.order_in(space.sim.model, **setup.options)
        for spec, share in ((coarse, gain / (gain - 1.0)), (fine, 1.0 / (gain - 1.0))):
            record, fields = made[spec]
            errors = self._total_errors(space, fields)
            errors += [each for kind in apart for each in Errors.of(kind, apart[kind], share)]
            self._keep(spec, record.model_copy(update={"errors": errors}), fields)

    def _apart(self, space: Discretisation, ours: History, right: History) -> dict[str, Any]:
        """Return the norms of time and slow-flow errors by kind and by common day."""
        days, model = [day for day in ours if day in right], space.sim.model
        return {
            kind: {day: errors(model, ours[day], right[day]) for day in days}
            for kind, errors in self._errors.items()
        }

    def _kept(self, spec: RunSpec) -> History | None:
        """Return the stored fields of a run at report days: {} if it failed, None if none are."""
        known = self._runner.known(spec)
        if known is None or known.status != "completed":
            return None if known is None else {}
        try:
            found = xr.load_dataset(self._folder / f"{spec.key}.nc", engine="netcdf4")
            return {
                float(day): {name: found[name].sel(report_day=day).values for name in KEPT}
                for day in found["report_day"].values
            }
        except (OSError, LookupError):
            return None

    def _keep(self, spec: RunSpec, record: RunRecord, history: History) -> None:
        """Write fields, then the record, so that the fields of every record exist."""
        if record.status == "completed":
            fields = {name: [of[name] for of in history.values()] for name in KEPT}
            variables = {name: (("report_day", "node"), of) for name, of in fields.items()}
            whole = xr.Dataset(variables, {"report_day": [*history]}, {"title": spec.label})
            write_whole(self._folder / f"{spec.key}.nc", as_netcdf(whole))
        if self._runner.known(spec) is None:
            self._runner.keep(record)

    def _total_errors(self, space: Discretisation, history: History) -> list[Errors]:
        """Return total errors, relative to the file of a day or the exact solution at the nodes."""
        found: dict[float, Norms] = {}
        for day, fields in history.items():
            right = self._right(space, day)
            if isinstance(right, OnGrid):
                whole = fields | {"b": space.sim.initial_fields["b"]}
                found[day] = right.errors(whole, space.scene.error_field)
            elif right is not None:
                found[day] = diagnostics.flow_errors(space.sim.model, fields, right)
        return Errors.of("total", found)


def _reference(study: Study, space: Discretisation, day: float) -> OnGrid | Fields | None:
    if study.files:
        path = study.files.get(day)
        return OnGrid(Reference(path), space.mesh) if path else None
    if space.scene.exact is None:
        return None
    fields = diagnostics.exact_fields(space.sim.model, day * DAY)
    # vorticity is computed from the exact wind on the mesh
    return fields | {"vorticity": vorticity(space.mesh, fields["u"], fields["v"])}
