"""Running one setting and taking its measure."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from swe_sphere.equations.scene import Scene
from swe_sphere.io.integrals import drifts, integrals
from swe_sphere.io.norms import area_mean, errors
from swe_sphere.io.tracer_diagnostics import tracer_errors, tracer_masses, tracer_numbers
from swe_sphere.mesh import Interpolator, Mesh, build_mesh
from swe_sphere.planet import DAY
from swe_sphere.simulation.warp_start import start_warp
from swe_sphere.studies.verify.case import CONVERGED, Setting

if TYPE_CHECKING:
    from swe_sphere.equations.model import Model

__all__ = ["Finer", "Measure", "measure"]

Array = NDArray[np.float64]
Fields = dict[str, Array]

CONVERGED_DT = 60.0
"""Step of rk4 in a run to compare with [s]."""


@dataclass(frozen=True)
class Measure:
    """What a run came to."""

    quantities: dict[str, float]
    dt: float
    """Step taken [s]."""
    seconds: float
    """Wall time of the steps alone [s]."""


@dataclass(frozen=True)
class _Run:
    model: Model
    start: Fields
    end: Fields
    time: float
    dt: float
    seconds: float

    @property
    def scene(self) -> Scene:
        return self.model.scene


class Finer:
    """The end of a run on a finer mesh, to be looked at on the nodes of others."""

    def __init__(self, setting: Setting) -> None:
        run = _integrate(setting)
        self._mesh, self._end = run.model.mesh, run.end

    def at_nodes(self, mesh: Mesh) -> Fields:
        """Wind and depth at the nodes of a mesh."""
        interpolator = Interpolator(self._mesh, mesh.lon, mesh.lat)
        u, v = interpolator.wind(self._end["u"], self._end["v"])
        return {"u": u, "v": v, "h": interpolator(self._end["h"])}


def measure(setting: Setting, against: str | Finer | None = None) -> Measure:
    """Run a setting and take, as far as they are defined,

    l1_h ... linf_v   errors against the exact solution, or what else is to be compared with
    rms_h, max_h      the same of depth, not normalised [m]
    l2_vorticity, decorrelation   against a reference; 1 - correlation of vorticity
    mass_drift, energy_drift, enstrophy_drift
    area              relative error of the sphere's area
    mean_depth [m], energy [m3 s-2], enstrophy [m-1 s-2], max_wind [m s-1], mean_bottom [m],
    rms_coriolis [s-1]   at the start
    max_v, max_speed [m s-1], min_depth [m]   at the end: largest northward wind either way,
        largest wind, least depth
    l1_q_NAME, l2_q_NAME, linf_q_NAME   errors of a tracer
    beyond_bounds, tracer_mass_drift   of all tracers: how far mixing ratios are out of the bounds
        of the initial ones, and the largest relative drift of mass
    """
    run = _integrate(setting)
    found = _invariants(run) | _all_errors(run, setting, against) | _tracers(run)
    return Measure(found, run.dt, run.seconds)


def _integrate(setting: Setting) -> _Run:
    start_warp()
    from swe_sphere.equations.model import Model
    from swe_sphere.steppers import get_stepper

    scene = setting.make_scene()
    mesh = build_mesh(setting.ne, setting.np, scene.planet.radius, **setting.mesh)
    model = Model(mesh, scene, precision=setting.precision, shape=setting.launch)
    cls, state = get_stepper(setting.stepper), model.initial_state()
    length, dt = setting.days * DAY, setting.dt
    if dt is None:
        spectrum = cls.spectrum(model, state)
        dt = cls.safety * cls.stable_dt(spectrum.wave, spectrum.dissipation)
    count = math.ceil(length / dt - 1e-9)
    stepper = cls(model, length / count if count else dt, **setting.options)
    stepper.start(state)
    started = time.perf_counter()
    for _ in range(count):
        stepper.step()
    seconds = time.perf_counter() - started
    start = _fields(model, state, 0.0)
    end = _fields(model, stepper.state, length)
    return _Run(model, start, end, length, stepper.dt, seconds)


def _fields(model: Model, state: Any, t: float) -> Fields:
    curl = model.vorticity(state, t)
    return model.fields(state, t) | {"b": model.bottom, "vorticity": curl}


def _invariants(run: _Run) -> dict[str, float]:
    """Drifts, and what the mesh and the initial state integrate to."""
    model = run.model
    mesh, names = model.mesh, ("u", "v", "h", "b", "vorticity")
    before, after = (
        integrals(mesh, model.scene.planet, f=model.coriolis, **{n: fields[n] for n in names})
        for fields in (run.start, run.end)
    )
    sphere = 4.0 * math.pi * mesh.radius**2
    return drifts(before, after) | {
        "area": abs(float(mesh.area.sum()) / sphere - 1.0),
        "mean_depth": before["mass"],
        "energy": before["energy"],
        "enstrophy": before["potential_enstrophy"],
        "max_wind": before["max_wind"],
        "mean_bottom": area_mean(mesh.area, model.bottom),
        "rms_coriolis": math.sqrt(area_mean(mesh.area, model.coriolis**2)),
        "max_v": float(np.abs(run.end["v"]).max()),
        "max_speed": after["max_wind"],
        "min_depth": after["min_depth"],
    }


def _tracers(run: _Run) -> dict[str, float]:
    """Errors, excursions and masses of tracers."""
    mesh, scene = run.model.mesh, run.scene
    if not scene.tracers:
        return {}
    masses = tracer_masses(mesh, run.start, scene.tracers)
    numbers = tracer_numbers(mesh, run.end, masses)
    firsts = {name: run.start[f"q_{name}"] for name in scene.tracers}
    under = [first.min() - numbers[f"min_q_{name}"] for name, first in firsts.items()]
    over = [numbers[f"max_q_{name}"] - first.max() for name, first in firsts.items()]
    found = {
        "beyond_bounds": float(max(*under, *over)),
        "tracer_mass_drift": max(abs(numbers[f"mass_drift_q_{name}"]) for name in firsts),
    }
    if scene.exact_tracers is None:
        return found
    return found | tracer_errors(mesh, run.end, scene.exact_tracers(mesh.lon, mesh.lat, run.time))


def _all_errors(run: _Run, setting: Setting, against: str | Finer | None) -> dict[str, float]:
    if against == CONVERGED:
        fine = replace(setting, dt=CONVERGED_DT, stepper="rk4", options={})
        return _errors(run, _integrate(fine).end)
    if isinstance(against, Finer):
        return _errors(run, against.at_nodes(run.model.mesh))
    if against is not None:
        return _reference_errors(run, against)
    if run.scene.exact is None:
        return {}
    mesh = run.model.mesh
    exact = run.scene.exact(mesh.lon, mesh.lat, run.time)
    return _errors(run, dict(zip("uvh", exact, strict=True)))


def _errors(run: _Run, other: Fields) -> dict[str, float]:
    """Errors of height and wind, the latter unless it is prescribed."""
    mesh, scene = run.model.mesh, run.scene
    names = "h" if scene.wind is not None else "uvh"
    bottom = run.model.bottom if scene.error_field == "surface" else None
    off = run.end["h"] - other["h"]
    absolute = {
        "rms_h": math.sqrt(area_mean(mesh.area, off**2)),
        "max_h": float(np.abs(off).max()),
    }
    return absolute | errors(mesh, run.end, {n: other[n] for n in names}, bottom)


def _reference_errors(run: _Run, name: str) -> dict[str, float]:
    """Errors of the free surface, and of wind and vorticity where the reference has them."""
    from swe_sphere.io.reference_solution import SHIPPED, Reference, reference_errors

    path, mesh = SHIPPED / f"{name}.nc", run.model.mesh
    reference = Reference(path)
    there = {"surface": "h", "vorticity": "vorticity"}
    if "u" in reference.fields:
        there["wind"] = "v"
    found = {
        f"{norm}_{short}": value
        for field, short in there.items()
        for norm, value in reference_errors(path, mesh, run.end, field).items()
    }
    ours = Interpolator(mesh, *reference.points)(run.end["vorticity"])
    covariance = np.cov(ours, reference.values("vorticity"), aweights=reference.area)
    product = math.sqrt(covariance[0, 0] * covariance[1, 1])
    return found | {"decorrelation": 1.0 - float(covariance[0, 1]) / product}
