"""Run a case and measure it: any outcome of the run becomes a record."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from swe_sphere.arrays import Array
from swe_sphere.errors import RunFailed
from swe_sphere.io.integrals import DRIFTS, Fields, area_mean, by_name, field_errors
from swe_sphere.io.reference_solution import SHIPPED, OnGrid, Reference
from swe_sphere.mesh import Interpolator, Mesh
from swe_sphere.planet import DAY
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.diagnostics import Snapshot, exact_fields, flow_errors
from swe_sphere.simulation.observers import Observer, Ticker
from swe_sphere.simulation.planning import RunPlan, free_steps
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.simulation.summary import Summary
from swe_sphere.steppers import get_stepper
from swe_sphere.studies.cases.case import Case
from swe_sphere.studies.cases.scenes import make_scene, random_setting
from swe_sphere.studies.record_store import Record, attempt, stepped

Tick = Callable[[str], None]
COSTS = ("newton_iterations", "krylov_iterations", "rejected_steps")
TIMES = ("seconds", "step_seconds", "dt")
"""Numbers of a record, if known: wall times of the case and of its steps, and the step [s]."""


class Measure(Record):
    """Outcome of a run of a case, and its numbers."""

    fingerprint: str
    """Fingerprint of the run, of its measurement and of the code."""
    reason: str
    """Why the run did not end well; empty if it did."""
    numbers: Mapping[str, float | None] = {}
    """Numbers by name, those of `TIMES` among them as far as they are known."""
    name: str
    """Name of the case."""
    status: str
    """How the run ended, as `Summary.status`."""


def measure(case: Case, tick: Tick | None = None) -> Measure:
    """Run a case and measure it; tick: called with the progress. Interrupted if asked to stop."""
    began = time.perf_counter()
    ended = attempt(lambda: METHODS[case.method](case, case.configured(), tick))
    return Measure(
        name=case.name, fingerprint=case.fingerprint, status=ended.status,
        reason=ended.reason or "", numbers=ended.numbers | {"seconds": time.perf_counter() - began},
    )  # fmt: skip


def _stepped(case: Case, sim: Simulation, tick: Tick | None, *observers: Observer) -> Summary:
    """Step a simulation to its end; tick: called with the progress."""

    def show(step: int) -> None:
        if tick is not None:
            day = sim.plan.time(step) / DAY
            tick(f"{case.name}: day {day:.3g}, step {step} of {sim.plan.steps}")

    return stepped(sim, [*observers, Ticker(show)], case.seconds)


def _errors(case: Case, run: RunConfig, tick: Tick | None) -> Summary:
    """Run a case and measure the following quantities, as far as they are defined.

    all of `Simulation.diagnostics` at the end, with errors relative to `Case.against`;
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
    ended = Summary() if case.method == "start" else _stepped(case, sim, tick)
    if ended.completed:
        ended.numbers.update(sim.diagnostics | _extremes(sim) | _errors_against(sim, case))
    ended.numbers.update({"dt": sim.plan.dt, "step_seconds": sim.wall_seconds})
    return ended


def _begun(run: RunConfig) -> Simulation:
    """Return the started simulation; it has frames only at both ends: others would limit dt."""
    if run.days:
        run = run.model_copy(update={"every": 24.0 * run.days})
    sim = Simulation(make_scene(run), config=run)
    sim.begin()
    return sim


@lru_cache(maxsize=1)
def _completed(run: RunConfig) -> Simulation:
    """Return the run with which all cases of a name are compared; RunFailed if it fails."""
    sim = _begun(run)
    if not (ended := stepped(sim)).completed:
        raise RunFailed(f"the run for comparison was {ended.status}: {ended.reason}")
    return sim


def _compared(sim: Simulation, case: Case, changes: dict[str, Any]) -> Fields:
    """Return the final fields of the case with changes of its run, at the nodes of `sim`."""
    other = _completed(case.configured(changes).model_copy(update={"tolerance": None}))
    at, fields = Interpolator(other.mesh, sim.mesh.lon, sim.mesh.lat), other.snapshot.fields
    u, v = at.wind(fields["u"], fields["v"])
    return {"u": u, "v": v, "h": at(fields["h"])}


def _extremes(sim: Simulation) -> dict[str, float]:
    """Return numbers of the mesh and the initial state, largest winds, and bounds of tracers."""
    mesh, model, before, end = sim.mesh, sim.model, sim.initial_fields, sim.diagnostics
    integrals, _ = sim.initial_numbers
    found = {
        "area": abs(float(mesh.area.sum()) / (4.0 * math.pi * mesh.radius**2) - 1.0),
        "mean_depth": integrals["mass"], "energy": integrals["energy"],
        "enstrophy": integrals["potential_enstrophy"], "max_wind": integrals["max_wind"],
        "mean_bottom": area_mean(mesh.area, model.bottom),
        "rms_coriolis": math.sqrt(area_mean(mesh.area, model.coriolis**2)),
        "max_v": float(np.abs(sim.snapshot.fields["v"]).max()), "max_speed": end["max_wind"],
    }  # fmt: skip
    if names := tuple(sim.scene.tracers or ()):
        under = [float(before[f"q_{name}"].min()) - end[f"min_q_{name}"] for name in names]
        over = [end[f"max_q_{name}"] - float(before[f"q_{name}"].max()) for name in names]
        found["beyond_bounds"] = max(*under, *over)
        found["tracer_mass_drift"] = max(abs(end[f"mass_drift_q_{name}"]) for name in names)
    return found


def _errors_against(sim: Simulation, case: Case) -> dict[str, float]:
    fields, against = sim.snapshot.fields, case.against
    if isinstance(against, dict):
        other = _compared(sim, case, against)
    elif against is not None:
        grid, ours = OnGrid(Reference(SHIPPED / f"{against}.nc"), sim.mesh), sim.snapshot
        errors = by_name(grid.errors(ours.all_fields, sim.scene.error_field))
        return errors | {"decorrelation": grid.decorrelation(ours.all_fields)}
    elif sim.scene.exact is not None:
        other = exact_fields(sim.model, sim.time)
    else:
        return {}
    off = fields["h"] - other["h"]
    return by_name(flow_errors(sim.model, fields, other)) | {
        "rms_h": math.sqrt(area_mean(sim.mesh.area, off**2)),
        "max_h": float(np.abs(off).max()),
    }


SAMPLES = 120
"""Approximate number of samples of a run."""
CHANGES = (*DRIFTS, "total_vorticity")
ERRORS_AT_END = ("l2_h", "l2_v", "linf_h", "off_wave", "off_mirror")
"""Numbers of which a series keeps the last sample, under the same name."""


@dataclass
class Series(Observer):
    """An observer that samples diagnostics and symmetries about `SAMPLES` times."""

    plan: RunPlan
    symmetries: Sequence[str] = ()
    """Keys of `SYMMETRIES`."""
    rows: list[dict[str, float]] = field(default_factory=list)
    """The samples."""

    def due(self, step: int) -> bool:
        return self.plan.is_sample(step, SAMPLES)

    def observe(self, snapshot: Snapshot) -> None:
        off = {x: SYMMETRIES[x](snapshot.model.mesh, snapshot.fields) for x in self.symmetries}
        self.rows.append({"day": snapshot.time / DAY} | snapshot.diagnostics | off)

    def numbers(self) -> dict[str, float]:
        """Return the numbers of the series, which has a sample.

        Drifts are the largest of either sign over the run; max_wind [m s-1] is the largest,
        min_depth [m] the least; wind_growth is max_wind over that of the start, froude the largest
        max_wind over max_wave, energy_gain the largest rise of energy. Values of
        `ERRORS_AT_END` are those at the end. symmetry_day is the first day on which off_wave
        exceeds 0.01, infinite if there is none. For growth_v and growth_h see `_growth`. For
        tracers there are extremes of mixing ratios, and the largest drift of a mass.
        """
        names = dict.fromkeys((*CHANGES, "max_wind", "max_wave", "min_depth", *self.rows[-1]))
        of = {name: np.array([row.get(name, math.nan) for row in self.rows]) for name in names}
        days, winds = of["day"], of["max_wind"]
        found = {name: np.abs(of[name]).max() for name in CHANGES} | {
            "max_wind": winds.max(),
            "wind_growth": winds.max() / winds[0] if winds[0] > 0.0 else math.nan,
            "froude": (winds / of["max_wave"]).max(), "min_depth": of["min_depth"].min(),
            "energy_gain": of["energy_drift"].max(), "last_day": days[-1],
        }  # fmt: skip
        found |= {name: of[name][-1] for name in ERRORS_AT_END if name in of}
        found |= {f"growth_{x}": _growth(of[f"l2_{x}"]) for x in "hv" if f"l2_{x}" in of}
        if "off_wave" in of:
            found["symmetry_day"] = min(days[of["off_wave"] > 1e-2], default=math.inf)
        found |= {name: x.min() for name, x in of.items() if name.startswith("min_q_")}
        found |= {name: x.max() for name, x in of.items() if name.startswith("max_q_")}
        masses = [np.abs(x).max() for name, x in of.items() if name.startswith("mass_drift_q_")]
        if masses:
            found["tracer_mass_drift"] = max(masses)
        return {name: float(x) for name, x in found.items()}


def _growth(errors: Array) -> float:
    """Return the largest error of the last third over three times that of the first third.

    It is 1 for an error that grows linearly, 3 for a quadratic one, 1/3 for a constant one.
    """
    third = len(errors) // 3
    early, late = errors[: third + 1].max(), errors[-third - 1 :].max()
    return float(late / (3.0 * early)) if early > 0.0 else math.nan


def off_wave(mesh: Mesh, fields: Fields) -> float:
    """Return the share of the northward wind whose zonal wavenumber is no multiple of four.

    It is the fraction of the mean of v² that is lost when v is averaged over quarter turns, which
    take nodes to nodes on an unturned, unstretched mesh.
    """
    v, once = fields["v"], _images(mesh, ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    turns = [np.arange(mesh.size), once, once[once], once[once[once]]]
    rest = v - sum(v[turn] for turn in turns) / 4.0
    return area_mean(mesh.area, rest**2) / (area_mean(mesh.area, v**2) or 1.0)


def off_mirror(mesh: Mesh, fields: Fields) -> float:
    """Return how far the depth differs between both sides of the equator.

    It is the rms of h less its mirror image, over the rms of its deviation from the mean.
    """
    h, other = fields["h"], _images(mesh, ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)))
    spread = area_mean(mesh.area, (h - area_mean(mesh.area, h)) ** 2) or 1.0
    return math.sqrt(area_mean(mesh.area, (h - h[other]) ** 2) / spread)


SYMMETRIES = {"off_wave": off_wave, "off_mirror": off_mirror}


@lru_cache(maxsize=2)
def _images(mesh: Mesh, matrix: tuple[tuple[float, ...], ...]) -> NDArray[np.intp]:
    """Return the index of the node to which each node is mapped; ValueError if there is none."""
    apart, found = KDTree(mesh.xyz).query(mesh.xyz @ np.array(matrix).T)
    if apart.max() > 1e-9:
        raise ValueError("the mesh does not have this symmetry: leave out stretch, centre and spin")
    return np.asarray(found)


def _series(case: Case, run: RunConfig, tick: Tick | None) -> Summary:
    """Run a case and measure extremes of the whole run, see `Series`, and its costs.

    apart_h, apart_v: relative l2 distance at the end from the run `against`.
    """
    sim = Simulation(make_scene(run), config=run)
    sim.begin(_plan(case, sim))
    series = Series(sim.plan, case.symmetries)
    series.observe(sim.snapshot)
    ended = _stepped(case, sim, tick, series)
    costs = sim.counts()
    numbers = series.numbers() | {
        "dt": sim.plan.dt, "dt_over_gravity": sim.plan.dt / sim.gravity_limit,
        "steps": float(sim.steps), "step_seconds": sim.wall_seconds,
        **{name: float(costs[name]) for name in COSTS if name in costs},
    }  # fmt: skip
    if ended.completed and isinstance(case.against, dict):
        other = _compared(sim, case, case.against)
        errors = field_errors(sim.mesh.area, sim.snapshot.fields, other)
        numbers |= {f"apart_{x}": errors[x]["l2"] for x in "hv"}
    ended.numbers.update(numbers)
    return ended


def _plan(case: Case, sim: Simulation) -> RunPlan | None:
    """Return the steps that the case prescribes; None if it prescribes none."""
    if case.part is None and case.courant is None:
        return None
    if case.part is not None and math.isfinite(sim.stable_dt()):
        dt = case.part * sim.stable_dt()
    else:
        dt = (case.courant or 1.0) * sim.gravity_limit
        if case.advective is not None and sim.model.strongest_wind > 0.0:
            dt = min(dt, case.advective * sim.mesh.spacing()[0] / sim.model.strongest_wind)
    if case.steps is None:
        return free_steps(sim.days, dt)
    whole = max(1, math.floor(sim.days * DAY / dt))
    count = case.steps if sim.config.days is None else min(case.steps, whole)
    return RunPlan(dt, count, count, dt)


WORST = ("mass_drift", "energy_gain", "froude", "rejected_steps")
"""Numbers of which a batch of runs keeps the largest."""


def _seeds(case: Case, _: RunConfig, tick: Tick | None) -> Summary:
    """Run each seed separately; measure how many `stopped`, and the worst numbers of all."""
    numbers, status, reason = {"seeds": float(len(case.seeds)), "stopped": 0.0}, "completed", ""
    for seed in case.seeds:
        if tick is not None:
            tick(f"{case.name}: seed {seed}")
        mesh, step = random_setting(seed)
        run = {**mesh, "set": {"scene": {"seed": seed}}}
        one = case.changed(run=run, advective=get_stepper(case.stepper).courant, **step)
        ended = attempt(partial(_series, one, one.configured(), None))
        for name in WORST:
            if name in ended.numbers:
                numbers[name] = max(numbers.get(name, -math.inf), ended.numbers[name])
        if not ended.completed:
            numbers["stopped"] += 1.0
            reason = reason or f"seed {seed}: {ended.status}: {ended.reason}"
        if ended.status in ("timed-out", "failed"):
            status, reason = ended.status, f"seed {seed}: {ended.status}: {ended.reason}"
    return Summary(status, reason, numbers=numbers)


METHODS = {"errors": _errors, "start": _errors, "series": _series, "seeds": _seeds}
