"""Running a case and measuring it: whatever happens in it is a record."""

from __future__ import annotations

import json
import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from swe_sphere.errors import RunFailed
from swe_sphere.io.norms import area_mean, by_name, field_errors
from swe_sphere.io.reference_solution import SHIPPED, OnGrid, Reference
from swe_sphere.io.scalar_fields import at_nodes
from swe_sphere.planet import DAY
from swe_sphere.simulation.diagnostics import exact_fields, flow_errors, state_integrals
from swe_sphere.simulation.loop import Interrupted
from swe_sphere.simulation.observers import Observer, Ticker
from swe_sphere.simulation.planning import RunPlan, free_steps
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.steppers import get_stepper
from swe_sphere.studies.cases.case import CONVERGED, Case, Level
from swe_sphere.studies.cases.configuration import Configuration
from swe_sphere.studies.cases.random_state import random_setting
from swe_sphere.studies.cases.series import SYMMETRIES, Series
from swe_sphere.studies.ended import Ended, attempt, stepped
from swe_sphere.studies.record_store import Result

Tick = Callable[[str], None]
COSTS = ("newton_iterations", "krylov_iterations", "rejected_steps")
TIMES = ("seconds", "step_seconds", "dt")
"""Numbers of every record: wall times of all and of the steps alone [s], and the step [s]."""


class Measure(Result):
    """What a run of a case came to: how it ended and its numbers, `TIMES` among them."""

    name: str
    """Name of the case."""
    status: str
    """How it ended, as `Summary.status`."""


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


def _progress(sim: Simulation, tick: Tick | None) -> list[Observer]:
    if tick is None:
        return []
    plan = sim.plan
    return [Ticker(lambda n: tick(f"day {plan.time(n) / DAY:.3g}, step {n} of {plan.steps}"))]


# --- errors, integrals and extremes


def _errors(case: Case, run: Configuration, tick: Tick | None) -> Ended:
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
    ended = Ended(sim=sim) if begins else stepped(sim, _progress(sim, tick), case.seconds)
    if ended.completed:
        ended.numbers = sim.diagnostics | _constants(sim) | _extremes(sim)
        ended.numbers |= _errors_against(sim, case, run)
    ended.numbers |= {"dt": sim.plan.dt, "step_seconds": sim.clock.wall_seconds}
    return ended


def _begun(run: Configuration) -> Simulation:
    """Return the run without frames between start and end, to which its step would have to fit."""
    days = run.config.days
    sim = run.changed({"every": 24.0 * days} if days else {}).simulation()
    sim.begin()
    return sim


def _completed(run: Configuration) -> Simulation:
    """Return a run to compare with, at its end; RunFailed where it does not get there."""
    sim = _begun(run)
    ended = stepped(sim)
    if not ended.completed:
        raise RunFailed(f"the run to compare with was {ended.status}: {ended.reason}")
    return sim


@lru_cache(maxsize=1)
def _finer(table: str) -> Simulation:
    """Return a run on a finer mesh, which all levels of a case share; table: its keys in JSON."""
    return _completed(Configuration(json.loads(table)))


def _constants(sim: Simulation) -> dict[str, float]:
    """Return integrals of the mesh and of the initial state."""
    mesh, model = sim.mesh, sim.model
    before = state_integrals(model, sim.start)
    sphere = 4.0 * math.pi * mesh.radius**2
    return {
        "area": abs(float(mesh.area.sum()) / sphere - 1.0),
        "mean_depth": before["mass"],
        "energy": before["energy"],
        "enstrophy": before["potential_enstrophy"],
        "max_wind": before["max_wind"],
        "mean_bottom": area_mean(mesh.area, model.bottom),
        "rms_coriolis": math.sqrt(area_mean(mesh.area, model.coriolis**2)),
    }


def _extremes(sim: Simulation) -> dict[str, float]:
    """Return the largest winds, and what tracers must not do."""
    end, names = sim.diagnostics, tuple(sim.scene.tracers or ())
    found = {
        "max_v": float(np.abs(sim.snapshot.fields["v"]).max()),
        "max_speed": end["max_wind"],
    }
    if not names:
        return found
    firsts = {name: sim.start[f"q_{name}"] for name in names}
    under = [float(first.min()) - end[f"min_q_{name}"] for name, first in firsts.items()]
    over = [end[f"max_q_{name}"] - float(first.max()) for name, first in firsts.items()]
    drifts = [abs(end[f"mass_drift_q_{name}"]) for name in names]
    return found | {"beyond_bounds": max(*under, *over), "tracer_mass_drift": max(drifts)}


CONVERGED_RUN = {"dt": 60.0, "stepper": "rk4", "tolerance": None}
"""Changes of a run that leave no time error."""


def _errors_against(sim: Simulation, case: Case, run: Configuration) -> dict[str, float]:
    against = case.against
    if against == CONVERGED:
        other = _completed(run.changed(CONVERGED_RUN)).snapshot.fields
    elif isinstance(against, dict):
        fine = _finer(json.dumps(case.base.changed(against).table))
        other = at_nodes(fine.mesh, fine.snapshot.fields, sim.mesh)
    elif against is not None:
        return _reference_errors(sim, against)
    elif sim.scene.exact is not None:
        other = exact_fields(sim.model, sim.time)
    else:
        return {}
    off = sim.snapshot.fields["h"] - other["h"]
    return by_name(flow_errors(sim.model, sim.snapshot.fields, other)) | {
        "rms_h": math.sqrt(area_mean(sim.mesh.area, off**2)),
        "max_h": float(np.abs(off).max()),
    }


def _reference_errors(sim: Simulation, name: str) -> dict[str, float]:
    """Return errors of the free surface, and of wind and vorticity that the reference has."""
    grid = OnGrid(Reference(SHIPPED / f"{name}.nc"), sim.mesh)
    fields = sim.snapshot.with_constants
    found = by_name(grid.errors(fields, sim.scene.error_field))
    return found | {"decorrelation": grid.decorrelation(fields)}


# --- series of samples


def _series(case: Case, run: Configuration, tick: Tick | None) -> Ended:
    """Run a case and measure extremes of the whole run, see `Series`, and its costs."""
    sim = run.simulation()
    sim.begin(_plan(case, sim))
    series = Series(sim.plan, [SYMMETRIES[name](sim.mesh) for name in case.symmetries])
    series.observe(sim.snapshot)
    ended = stepped(sim, [series, *_progress(sim, tick)], case.seconds)
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
    own = case.part is not None and math.isfinite(sim.stable_dt())
    dt = (case.part or 1.0) * sim.stable_dt() if own else _implicit_step(case, sim)
    if case.steps is None:
        return free_steps(sim.days, dt)
    whole = max(1, math.floor(sim.days * DAY / dt))
    count = case.steps if sim.config.days is None else min(case.steps, whole)
    return RunPlan(dt, count, count, dt)


def _implicit_step(case: Case, sim: Simulation) -> float:
    """Return the step [s] of `courant`, within the advective Courant number that it may have."""
    dt = (case.courant or 1.0) * sim.setup.gravity_limit()
    if case.advective is None:
        return dt
    wind = float(np.hypot(sim.start["u"], sim.start["v"]).max())
    return min(dt, case.advective * sim.mesh.spacing()[0] / wind) if wind > 0.0 else dt


def _precisions(case: Case, run: Configuration, tick: Tick | None) -> Ended:
    """Run a case in float32, and measure apart_h, apart_v: relative l2 distance from float64."""
    exact = _series(case, run.changed({"precision": "float64"}), tick)
    if exact.sim is None or not exact.completed:
        return replace(exact, reason=f"in float64: {exact.reason}")
    rough = _series(case, run.changed({"precision": "float32"}), tick)
    if rough.sim is not None and rough.completed:
        ours, theirs = (sim.snapshot.fields for sim in (rough.sim, exact.sim))
        apart = field_errors(rough.sim.mesh.area, ours, theirs)
        rough.numbers |= {"apart_h": apart["h"]["l2"], "apart_v": apart["v"]["l2"]}
    return rough


WORST = ("mass_drift", "energy_gain", "froude", "rejected_steps")
"""Numbers of which the largest of a batch of runs is kept."""


def _seeds(case: Case, run: Configuration, tick: Tick | None) -> Ended:
    """Run each seed by itself and measure how many `stopped`, and the worst numbers of all."""
    batch = Ended(numbers={"seeds": float(len(case.seeds)), "stopped": 0.0})
    numbers = batch.numbers
    for seed in case.seeds:
        if tick is not None:
            tick(f"seed {seed}")
        one = _of_seed(case, seed)
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


def _of_seed(case: Case, seed: int) -> Case:
    mesh, length = random_setting(seed)
    advective = get_stepper(case.stepper).courant
    scene = {"scene": "cases:random-state", "set": {"scene": {"seed": seed}}}
    return case.changed(
        run={**mesh, **scene}, part=length.part, courant=length.courant, advective=advective
    )


# --- files


def _file(case: Case, run: Configuration, tick: Tick | None) -> Ended:
    """Run as the command does, with a file, and count its NaN and infinities: not_finite."""
    if case.part is not None:
        run = run.changed({"dt": case.part * run.simulation().stable_dt()})
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "case.nc"
        summary = run.simulation().run(out=path, progress=False, warn=lambda text: None)
        if summary.status == "interrupted":
            raise Interrupted(summary.reason)
        numbers = {name: float(summary[name] or 0.0) for name in ("dt", "steps")}
        numbers |= {"not_finite": _not_finite(path), "last_day": float(summary["days"] or 0.0)}
    return Ended(summary.status, summary.reason or "", numbers)


def _not_finite(path: Path) -> float:
    """Return how many values of the fields in a file are NaN, infinite or missing."""
    import netCDF4

    with netCDF4.Dataset(path) as data:
        fields = (data[name][:] for name in ("u", "v", "h", "vorticity", "divergence"))
        return float(sum((~np.isfinite(np.ma.filled(x, np.nan))).sum() for x in fields))


METHODS: dict[str, Callable[[Case, Configuration, Tick | None], Ended]] = {
    "errors": _errors,
    "start": _errors,
    "series": _series,
    "file": _file,
    "precisions": _precisions,
    "seeds": _seeds,
}
"""All ways to measure by name."""
