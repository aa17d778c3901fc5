"""Running a case and measuring it: whatever happens in it is a record."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from swe_sphere.errors import RunFailed
from swe_sphere.io.norms import area_mean, by_name, field_errors
from swe_sphere.io.reference_solution import SHIPPED, OnGrid, Reference
from swe_sphere.io.scalar_fields import at_nodes
from swe_sphere.planet import DAY
from swe_sphere.simulation.build import Inputs
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.diagnostics import exact_fields, flow_errors, state_integrals
from swe_sphere.simulation.loop import Interrupted
from swe_sphere.simulation.observers import Observer, Ticker
from swe_sphere.simulation.planning import RunPlan, free_steps
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.steppers import get_stepper
from swe_sphere.studies.cases.case import CONVERGED, Case, Level
from swe_sphere.studies.cases.scenes import make_scene, random_setting
from swe_sphere.studies.cases.series import SYMMETRIES, Series
from swe_sphere.studies.ended import Ended, attempt, stepped
from swe_sphere.studies.record_store import Record

Tick = Callable[[str], None]
COSTS = ("newton_iterations", "krylov_iterations", "rejected_steps")
TIMES = ("seconds", "step_seconds", "dt")
"""Numbers of every record: wall times of all and of the steps alone [s], and the step [s]."""


class Measure(Record):
    """How a run of a case ended, and its numbers."""

    fingerprint: str
    """Fingerprint of the run, of its measurement and of the code."""
    reason: str
    """Why the run did not end well; empty if it did."""
    numbers: Mapping[str, float | None] = {}
    """Numbers by name, `TIMES` among them."""
    name: str
    """Name of the case."""
    status: str
    """How the run ended, as `Summary.status`."""


def measure(case: Case, level: Level, tick: Tick | None = None) -> Measure:
    """Run a level of a case and measure it as its method says; tick: called with the progress.

    Raises:
        Interrupted: the user asked to stop.
    """
    began = time.perf_counter()
    ended = attempt(lambda: METHODS[case.method](case, case.at(level), tick))
    return Measure(
        name=case.name,
        fingerprint=case.fingerprint(level),
        status=ended.status,
        reason=ended.reason,
        numbers=ended.numbers | {"seconds": time.perf_counter() - began},
    )


def _progress(case: Case, sim: Simulation, tick: Tick | None) -> list[Observer]:
    if tick is None:
        return []
    plan, name = sim.plan, case.name
    return [
        Ticker(lambda n: tick(f"{name}: day {plan.time(n) / DAY:.3g}, step {n} of {plan.steps}"))
    ]


# --- errors, integrals and extremes


def _errors(case: Case, run: RunConfig, tick: Tick | None) -> Ended:
    """Run a case and measure, as far as they are defined,

    all of `Simulation.diagnostics` at the end; its errors are those against `Case.against`;
    rms_h, max_h      errors of depth, not normalised [m];
    l2_vorticity, decorrelation   against a reference; 1 - correlation of vorticity;
    area              relative error of the sphere's area;
    mean_depth [m], energy [m3 s-2], enstrophy [m-1 s-2], max_wind [m s-1], mean_bottom [m],
    rms_coriolis [s-1]   of the initial state;
    max_v, max_speed [m s-1]   largest northward wind in size, and largest wind at the end;
    beyond_bounds, tracer_mass_drift   of all tracers: how far mixing ratios are out of the bounds
        of the initial ones, and the largest relative drift of mass.
    """
    sim = _begun(run)
    begins = case.method == "start"
    ended = Ended(sim=sim) if begins else stepped(sim, _progress(case, sim, tick), case.seconds)
    if ended.completed:
        ended.numbers = sim.diagnostics | _extremes(sim) | _errors_against(sim, case, run)
    ended.numbers |= {"dt": sim.plan.dt, "step_seconds": sim.clock.wall_seconds}
    return ended


def _simulation(run: RunConfig) -> Simulation:
    return Simulation(Inputs(run, make_scene(run)))


def _begun(run: RunConfig) -> Simulation:
    """Return the run without frames between start and end, to which its step would have to fit."""
    sim = _simulation(_with(run, every=24.0 * run.days) if run.days else run)
    sim.begin()
    return sim


def _with(run: RunConfig, **changes: object) -> RunConfig:
    return run.model_copy(update=changes)


@lru_cache(maxsize=1)
def _completed(run: RunConfig) -> Simulation:
    """Return a run that all levels of a case are compared with; RunFailed where it fails."""
    sim = _begun(run)
    ended = stepped(sim)
    if not ended.completed:
        raise RunFailed(f"the run to compare with was {ended.status}: {ended.reason}")
    return sim


def _extremes(sim: Simulation) -> dict[str, float]:
    """Return numbers of the mesh and the initial state, largest winds, and bounds of tracers."""
    mesh, model, before, end = sim.mesh, sim.model, sim.start, sim.diagnostics
    integrals = state_integrals(model, before)
    found = {
        "area": abs(float(mesh.area.sum()) / (4.0 * math.pi * mesh.radius**2) - 1.0),
        "mean_depth": integrals["mass"],
        "energy": integrals["energy"],
        "enstrophy": integrals["potential_enstrophy"],
        "max_wind": integrals["max_wind"],
        "mean_bottom": area_mean(mesh.area, model.bottom),
        "rms_coriolis": math.sqrt(area_mean(mesh.area, model.coriolis**2)),
        "max_v": float(np.abs(sim.snapshot.fields["v"]).max()),
        "max_speed": end["max_wind"],
    }
    if names := tuple(sim.scene.tracers or ()):
        under = [float(before[f"q_{name}"].min()) - end[f"min_q_{name}"] for name in names]
        over = [end[f"max_q_{name}"] - float(before[f"q_{name}"].max()) for name in names]
        found["beyond_bounds"] = max(*under, *over)
        found["tracer_mass_drift"] = max(abs(end[f"mass_drift_q_{name}"]) for name in names)
    return found


def _errors_against(sim: Simulation, case: Case, run: RunConfig) -> dict[str, float]:
    fields, against = sim.snapshot.fields, case.against
    if against == CONVERGED:
        other = _completed(_with(run, dt=60.0, stepper="rk4", tolerance=None)).snapshot.fields
    elif isinstance(against, dict):
        fine = _completed(case.configured(against))
        other = at_nodes(fine.mesh, fine.snapshot.fields, sim.mesh)
    elif against is not None:
        grid, ours = OnGrid(Reference(SHIPPED / f"{against}.nc"), sim.mesh), sim.snapshot
        errors = by_name(grid.errors(ours.with_constants, sim.scene.error_field))
        return errors | {"decorrelation": grid.decorrelation(ours.with_constants)}
    elif sim.scene.exact is not None:
        other = exact_fields(sim.model, sim.time)
    else:
        return {}
    off = fields["h"] - other["h"]
    return by_name(flow_errors(sim.model, fields, other)) | {
        "rms_h": math.sqrt(area_mean(sim.mesh.area, off**2)),
        "max_h": float(np.abs(off).max()),
    }


# --- series of samples


def _series(case: Case, run: RunConfig, tick: Tick | None) -> Ended:
    """Run a case and measure extremes of the whole run, see `Series`, and its costs."""
    sim = _simulation(run)
    sim.begin(_plan(case, sim))
    series = Series(sim.plan, [SYMMETRIES[name](sim.mesh) for name in case.symmetries])
    series.observe(sim.snapshot)
    ended = stepped(sim, [series, *_progress(case, sim, tick)], case.seconds)
    costs = sim.stepper.costs()
    ended.numbers = series.numbers() | {
        "dt": sim.plan.dt,
        "dt_over_gravity": sim.plan.dt / sim.setup.gravity_limit(),
        "steps": float(sim.steps),
        "step_seconds": sim.clock.wall_seconds,
        **{name: float(costs[name]) for name in COSTS if name in costs},
    }
    return ended


def _plan(case: Case, sim: Simulation) -> RunPlan | None:
    """Return the steps that the case prescribes; None: as an ordinary run chooses them."""
    if case.part is None and case.courant is None:
        return None
    if case.part is not None and math.isfinite(sim.stable_dt()):
        dt = case.part * sim.stable_dt()
    else:
        dt = (case.courant or 1.0) * sim.setup.gravity_limit()
        wind = float(np.hypot(sim.start["u"], sim.start["v"]).max())
        if case.advective is not None and wind > 0.0:
            dt = min(dt, case.advective * sim.mesh.spacing()[0] / wind)
    if case.steps is None:
        return free_steps(sim.days, dt)
    whole = max(1, math.floor(sim.days * DAY / dt))
    count = case.steps if sim.config.days is None else min(case.steps, whole)
    return RunPlan(dt, count, count, dt)


def _precisions(case: Case, run: RunConfig, tick: Tick | None) -> Ended:
    """Run a case in float32, and measure apart_h, apart_v: relative l2 distance from float64."""
    exact = _series(case, _with(run, precision="float64"), tick)
    if exact.sim is None or not exact.completed:
        return replace(exact, reason=f"in float64: {exact.reason}")
    rough = _series(case, _with(run, precision="float32"), tick)
    if rough.sim is not None and rough.completed:
        ours, theirs = (sim.snapshot.fields for sim in (rough.sim, exact.sim))
        apart = field_errors(rough.sim.mesh.area, ours, theirs)
        rough.numbers |= {"apart_h": apart["h"]["l2"], "apart_v": apart["v"]["l2"]}
    return rough


WORST = ("mass_drift", "energy_gain", "froude", "rejected_steps")
"""Numbers of which the largest of a batch of runs is kept."""


def _seeds(case: Case, _: RunConfig, tick: Tick | None) -> Ended:
    """Run each seed by itself and measure how many `stopped`, and the worst numbers of all."""
    batch = Ended(numbers={"seeds": float(len(case.seeds)), "stopped": 0.0})
    numbers = batch.numbers
    for seed in case.seeds:
        if tick is not None:
            tick(f"{case.name}: seed {seed}")
        mesh, step = random_setting(seed)
        run = {**mesh, "scene": "cases:random-state", "set": {"scene": {"seed": seed}}}
        one = case.changed(run=run, advective=get_stepper(case.stepper).courant, **step)
        ended = attempt(partial(_series, one, one.base, None))
        for name in WORST:
            if name in ended.numbers:
                numbers[name] = max(numbers.get(name, -math.inf), ended.numbers[name])
        if not ended.completed:
            numbers["stopped"] += 1.0
            batch.reason = batch.reason or f"seed {seed}: {ended.status}: {ended.reason}"
        if ended.status in ("timed-out", "failed"):
            batch.status = ended.status
    return batch


# --- files


def _file(case: Case, run: RunConfig, tick: Tick | None) -> Ended:
    """Run as the command does, with a file, and count its values that are no numbers: not_finite.

    Missing values count too.
    """
    import netCDF4

    if case.part is not None:
        run = _with(run, dt=case.part * _simulation(run).stable_dt())
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "case.nc"
        summary = _simulation(run).run(out=path, progress=False, warn=lambda text: None)
        if summary.status == "interrupted":
            raise Interrupted(summary.reason)
        numbers = {name: float(summary[name] or 0.0) for name in ("dt", "steps")}
        with netCDF4.Dataset(path) as data:
            fields = (data[name][:] for name in ("u", "v", "h", "vorticity", "divergence"))
            bad = sum((~np.isfinite(np.ma.filled(x, np.nan))).sum() for x in fields)
        numbers |= {"not_finite": float(bad), "last_day": float(summary["days"] or 0.0)}
    return Ended(summary.status, summary.reason or "", numbers)


METHODS: dict[str, Callable[[Case, RunConfig, Tick | None], Ended]] = {
    "errors": _errors,
    "start": _errors,
    "series": _series,
    "file": _file,
    "precisions": _precisions,
    "seeds": _seeds,
}
"""All ways to measure by name."""
