"""The numbers that tell how a run is doing: integrals, drifts, Courant numbers, errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.io.integrals import courant_numbers, drifts, integrals
from swe_sphere.io.norms import errors
from swe_sphere.io.tracer_diagnostics import tracer_errors, tracer_masses, tracer_numbers
from swe_sphere.planet import DAY
from swe_sphere.simulation.snapshot import Fields, Snapshot

if TYPE_CHECKING:
    from swe_sphere.equations.model import Model


def state_integrals(model: Model, fields: Fields) -> dict[str, float]:
    """Global integrals and extremes of a state; fields: u, v, h, vorticity, divergence (N,)."""
    names = ("u", "v", "h", "vorticity", "divergence")
    values = {name: fields[name] for name in names}
    return integrals(model.mesh, model.scene.planet, b=model.bottom, f=model.coriolis, **values)


def flow_errors(model: Model, fields: Fields, right: Mapping[str, Array]) -> dict[str, float]:
    """l1, l2 and linf of height and wind against the right u, v, h (N,).

    A prescribed wind has no error; heights are those of the scene's `error_field`.
    """
    scene = model.scene
    names = "h" if scene.wind is not None else "uvh"
    bottom = model.bottom if scene.error_field == "surface" else None
    return errors(model.mesh, fields, {name: right[name] for name in names}, bottom)


def exact_errors(model: Model, fields: Fields, time: float) -> dict[str, float]:
    """Errors at time [s] against what is known exactly of the scene; NaN where it is not known."""
    scene, lon, lat = model.scene, model.mesh.lon, model.mesh.lat
    found: dict[str, float] = {}
    if scene.exact is not None:
        exact = dict(zip("uvh", scene.exact(lon, lat, time), strict=True))
        found = flow_errors(model, fields, exact)
    if scene.exact_tracers is not None:
        found |= tracer_errors(model.mesh, fields, scene.exact_tracers(lon, lat, time))
    return found


OF_FREE_WINDS = ("energy", "potential_enstrophy", "energy_drift", "enstrophy_drift")
"""Numbers that say nothing where the wind is prescribed: what changes them is the scene."""


class Evaluator:
    """All numbers of a state; drifts are relative to the scene's own start.

    start: all fields at the very start, each (N,).  dt: tells the length of the present step [s].
    """

    def __init__(self, model: Model, start: Fields, dt: Callable[[], float]) -> None:
        self._model, self._dt = model, dt
        self.start = state_integrals(model, start)
        """Integrals at the start."""
        self._masses = tracer_masses(model.mesh, start, model.scene.tracers or ())

    def __call__(self, snapshot: Snapshot) -> dict[str, float]:
        """Integrals, drifts, Courant numbers, numbers of tracers and exact errors of a state."""
        mesh, fields = self._model.mesh, snapshot.all_fields
        now = state_integrals(self._model, fields)
        left_out = OF_FREE_WINDS if self._model.scene.wind is not None else ()
        numbers = {
            **now,
            **drifts(self.start, now),
            **tracer_numbers(mesh, fields, self._masses),
            **courant_numbers(mesh, self._dt(), now),
            **exact_errors(self._model, fields, snapshot.time),
        }
        return {name: value for name, value in numbers.items() if name not in left_out}


class ReferenceErrors:
    """Errors of the last state against a reference on a latitude-longitude grid.

    Raises ConfigError if the reference cannot be read or is of another time than the end [days].
    """

    def __init__(self, path: Path, field: str, days: float) -> None:
        from swe_sphere.io.reference_solution import Reference  # needs scipy's splines

        reference = Reference(path)
        if reference.time is not None and abs(reference.time - days * DAY) > 1.0:
            raise ConfigError(
                f"{path} is of day {reference.time / DAY:g}, the run ends at day {days:g}:"
                f" take days={reference.time / DAY:g} or another reference"
            )
        self._path = path
        height = field if field in reference.fields else "h"
        self._fields = {"h": height}
        if {"u", "v"} <= reference.fields.keys():
            self._fields["v"] = "wind"

    def __call__(self, model: Model, snapshot: Snapshot) -> dict[str, float]:
        """l1_h, l2_h, linf_h and, where the reference has a wind, l1_v, l2_v, linf_v."""
        from swe_sphere.io.reference_solution import reference_errors

        fields = snapshot.with_constants
        return {
            f"{norm}_{name}": value
            for name, field in self._fields.items()
            for norm, value in reference_errors(self._path, model.mesh, fields, field).items()
        }
