"""Ways to measure a trial: a plain run, one with a file, two precisions, a batch of seeds."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from swe_sphere.io.norms import field_errors
from swe_sphere.planet import DAY
from swe_sphere.simulation.interrupt import Interrupted
from swe_sphere.simulation.progress import Watcher
from swe_sphere.simulation.running import Running
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.simulation.time_plan import TimePlan, free_steps
from swe_sphere.steppers import get_stepper
from swe_sphere.studies.ended import Ended, attempt, stepped
from swe_sphere.studies.jobs import Tell, in_processes
from swe_sphere.studies.stress.random_state import random_setting
from swe_sphere.studies.stress.series import SYMMETRIES, Series
from swe_sphere.studies.stress.trial import Result, Trial, judge

Tick = Callable[[str], None]
COSTS = ("newton_iterations", "krylov_iterations", "rejected_steps")


def try_out(trial: Trial, tick: Tick | None = None) -> Result:
    """Run the trial and judge it."""
    return judge(trial, METHODS[trial.method](trial, tick))


def tried_beside(jobs: int, trials: Sequence[Trial]) -> Iterator[Result]:
    """What the trials come to, in processes beside each other, as it comes.

    Raises as `in_processes`.
    """
    yield from in_processes(jobs, _trying, (), trials)


def _trying(tell: Tell) -> Callable[[Trial], None]:
    return lambda trial: tell(try_out(trial))


def _run(trial: Trial, tick: Tick | None = None) -> Ended:
    """Make the run to its end or to where it fails, whatever happens.

    Raises:
        Interrupted: the user asked to stop.
    """
    began = time.perf_counter()
    ended = attempt(lambda: _watched(trial, tick))
    ended.numbers["seconds"] = time.perf_counter() - began
    return ended


def _watched(trial: Trial, tick: Tick | None) -> Ended:
    sim = trial.configuration.simulation()
    sim.begin(_plan(trial, sim))
    series = Series(sim.plan, [SYMMETRIES[name](sim.mesh) for name in trial.symmetries])
    series.observe(sim)
    told = None if tick is None else (lambda sim: tick(_told(sim)))
    ended = stepped(sim, [series], told, trial.seconds)
    ended.numbers = series.numbers() | _costs(sim)
    return ended


def _told(sim: Running) -> str:
    """How far it is."""
    return f"day {sim.time / DAY:.3g}, step {sim.steps} of {sim.plan.steps}"


def _plan(trial: Trial, sim: Simulation) -> TimePlan | None:
    """Steps as the trial has them; None: as an ordinary run chooses them."""
    if trial.part is None and trial.courant is None:
        return None
    own = trial.part is not None and math.isfinite(sim.stable_dt)
    dt = (trial.part or 1.0) * sim.stable_dt if own else _implicit_step(trial, sim)
    if trial.steps is None:
        return free_steps(sim.days, dt)
    whole = max(1, math.floor(sim.days * DAY / dt))
    count = trial.steps if sim.config.days is None else min(trial.steps, whole)
    return TimePlan(dt, count, count, dt)


def _implicit_step(trial: Trial, sim: Simulation) -> float:
    """The step in gravity-wave limits [s], within the advective Courant number it may have."""
    dt = (trial.courant or 1.0) * sim.gravity_limit
    if trial.advective is None:
        return dt
    wind = float(np.hypot(sim.start["u"], sim.start["v"]).max())
    return min(dt, trial.advective * sim.mesh.spacing()[0] / wind) if wind > 0.0 else dt


def _costs(sim: Simulation) -> dict[str, float]:
    costs = sim.stepper.costs()
    return {
        "dt": sim.plan.dt,
        "dt_over_gravity": sim.plan.dt / sim.gravity_limit,
        "steps": float(sim.steps),
        "step_seconds": sim.wall_seconds,
        **{name: float(costs[name]) for name in COSTS if name in costs},
    }


def _with_file(trial: Trial, tick: Tick | None) -> Ended:
    """Run as the command does, with a file, and count NaN and infinities in it: not_finite."""
    with tempfile.TemporaryDirectory() as folder:
        return attempt(lambda: _written(trial, Path(folder) / "trial.nc"))


def _written(trial: Trial, path: Path) -> Ended:
    run = trial.configuration
    if trial.part is not None:
        run = run.changed({"dt": trial.part * run.simulation().stable_dt})
    summary = run.simulation().run(out=path, watcher=Watcher())
    if summary.status == "interrupted":
        raise Interrupted(summary.reason)
    numbers = {name: float(summary[name] or 0.0) for name in ("dt", "steps")}
    numbers |= {"not_finite": _not_finite(path), "last_day": float(summary["days"] or 0.0)}
    return Ended(summary.status, summary.reason or "", numbers)


def _not_finite(path: Path) -> float:
    """Values of the fields in a file that are NaN, infinite, or missing."""
    import netCDF4

    with netCDF4.Dataset(path) as data:
        fields = (data[name][:] for name in ("u", "v", "h", "vorticity", "divergence"))
        return float(sum((~np.isfinite(np.ma.filled(x, np.nan))).sum() for x in fields))


def _two_precisions(trial: Trial, tick: Tick | None) -> Ended:
    """The run in float32, and apart_h, apart_v: relative l2 distance from that in float64."""
    exact = _run(trial.changed(run={"precision": "float64"}), tick)
    if exact.sim is None or not exact.completed:
        exact.reason = f"in float64: {exact.reason}"
        return exact
    rough = _run(trial.changed(run={"precision": "float32"}), tick)
    if rough.sim is not None and rough.completed:
        ours, theirs = (sim.snapshot.fields for sim in (rough.sim, exact.sim))
        apart = field_errors(rough.sim.mesh.area, ours, theirs)
        rough.numbers |= {"apart_h": apart["h"]["l2"], "apart_v": apart["v"]["l2"]}
    rough.numbers["seconds"] += exact.numbers["seconds"]
    return rough


WORST = ("mass_drift", "energy_gain", "froude", "rejected_steps")
"""Of a batch of runs the largest of these is told."""


def _seeds(trial: Trial, tick: Tick | None) -> Ended:
    """Each seed by itself: how many `stopped`, and the worst numbers of all."""
    batch = Ended(numbers={"seeds": float(len(trial.seeds)), "stopped": 0.0, "seconds": 0.0})
    for seed in trial.seeds:
        if tick is not None:
            tick(f"seed {seed}")
        _add(batch, seed, _run(_of_seed(trial, seed)))
    return batch


def _of_seed(trial: Trial, seed: int) -> Trial:
    mesh, length = random_setting(seed)
    advective = get_stepper(trial.run["stepper"]).courant
    scene = {"scene": "stress:random-state", "set": {"scene": {"seed": seed}}}
    return trial.changed(
        run={**mesh, **scene}, part=length.part, courant=length.courant, advective=advective
    )


def _add(batch: Ended, seed: int, ended: Ended) -> None:
    numbers = batch.numbers
    numbers["seconds"] += ended.numbers["seconds"]
    for name in WORST:
        if name in ended.numbers:
            numbers[name] = max(numbers.get(name, -math.inf), ended.numbers[name])
    if not ended.completed:
        numbers["stopped"] += 1.0
        batch.reason = batch.reason or f"seed {seed}: {ended.status}: {ended.reason}"
    if ended.status in ("timed-out", "failed"):
        batch.status = ended.status


METHODS: dict[str, Callable[[Trial, Tick | None], Ended]] = {
    "run": _run,
    "file": _with_file,
    "precisions": _two_precisions,
    "seeds": _seeds,
}
"""All ways to measure by name."""
