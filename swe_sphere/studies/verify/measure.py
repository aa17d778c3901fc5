"""Running one configuration and taking its measure."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from swe_sphere.errors import RunFailed
from swe_sphere.io.norms import area_mean, by_name
from swe_sphere.io.reference_solution import SHIPPED, OnGrid, Reference
from swe_sphere.io.scalar_fields import at_nodes
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.simulation.snapshot import exact_fields, flow_errors, state_integrals
from swe_sphere.studies.configuration import Configuration
from swe_sphere.studies.ended import Ended, attempt, stepped
from swe_sphere.studies.record_store import Result
from swe_sphere.studies.verify.case import CONVERGED

CONVERGED_RUN = {"dt": 60.0, "stepper": "rk4", "tolerance": None}
"""What differs in a run to compare with whose time error is none."""


class Measure(Result):
    """What a run came to: all numbers, and with them its step dt [s] and the seconds of its steps.

    None but these two of a run that did not get to its end.
    """

    status: str
    """How it ended, as `Summary.status`."""


Finer = Callable[[], Simulation]
"""Makes the run on a finer mesh that others are compared with."""


def measure(
    configuration: Configuration,
    against: str | Finer | None = None,
    start: bool = False,
    fingerprint: str = "",
) -> Measure:
    """Run a configuration (start: look at its initial state alone) and take, as far as defined,

    all that `Simulation.diagnostics` has at the end, with errors against what else is to be
    compared with in the place of those against the exact solution, and
    rms_h, max_h      errors of depth, not normalised [m]
    l2_vorticity, decorrelation   against a reference; 1 - correlation of vorticity
    area              relative error of the sphere's area
    mean_depth [m], energy [m3 s-2], enstrophy [m-1 s-2], max_wind [m s-1], mean_bottom [m],
    rms_coriolis [s-1]   at the start
    max_v, max_speed [m s-1]   at the end: largest northward wind either way, largest wind
    beyond_bounds, tracer_mass_drift   of all tracers: how far mixing ratios are out of the bounds
        of the initial ones, and the largest relative drift of mass
    """
    ended = attempt(lambda: _measured(configuration, against, start))
    sim = ended.sim
    dt, seconds = (math.nan, 0.0) if sim is None else (sim.plan.dt, sim.wall_seconds)
    return Measure(
        fingerprint=fingerprint, status=ended.status, reason=ended.reason,
        numbers=ended.numbers | {"dt": dt, "seconds": seconds},
    )  # fmt: skip


def _measured(configuration: Configuration, against: str | Finer | None, start: bool) -> Ended:
    sim = _simulation(configuration)
    ended = Ended(sim=sim) if start else stepped(sim)
    if ended.completed:
        ended.numbers = sim.diagnostics | _constants(sim) | _extremes(sim)
        ended.numbers |= _errors(sim, configuration, against)
    return ended


def _simulation(configuration: Configuration) -> Simulation:
    """The run with no frames between start and end, to which its step would have to fit."""
    days = configuration.config.days
    sim = configuration.changed({"every": 24.0 * days} if days else {}).simulation()
    sim.begin()
    return sim


def completed(configuration: Configuration) -> Simulation:
    """A run to compare with, at its end; RunFailed where it does not get there."""
    sim = _simulation(configuration)
    ended = stepped(sim)
    if not ended.completed:
        raise RunFailed(f"the run to compare with was {ended.status}: {ended.reason}")
    return sim


def _constants(sim: Simulation) -> dict[str, float]:
    """What the mesh and the initial state integrate to."""
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
    """Largest winds, and what tracers do that they should not."""
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


def _errors(
    sim: Simulation, configuration: Configuration, against: str | Finer | None
) -> dict[str, float]:
    if against == CONVERGED:
        other = completed(configuration.changed(CONVERGED_RUN)).snapshot.fields
    elif callable(against):
        fine = against()
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
    """Errors of the free surface, and of wind and vorticity where the reference has them."""
    grid = OnGrid(Reference(SHIPPED / f"{name}.nc"), sim.mesh)
    fields = sim.snapshot.with_constants
    found = by_name(grid.errors(fields, sim.scene.error_field))
    return found | {"decorrelation": grid.decorrelation(fields)}
