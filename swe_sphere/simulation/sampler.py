"""The numbers that tell how a run is doing: integrals, drifts, Courant numbers, errors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from swe_sphere.errors import ConfigError
from swe_sphere.io.diagnostics import courant_numbers, drifts, integrals
from swe_sphere.io.norms import errors
from swe_sphere.io.tracer_diagnostics import tracer_errors, tracer_masses, tracer_numbers
from swe_sphere.planet import DAY
from swe_sphere.simulation.snapshot import Moment

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from swe_sphere.equations.model import Model

__all__ = ["ReferenceErrors", "Sampler"]


class Sampler:
    """Diagnostics of a state; drifts are relative to the scene's own start."""

    def __init__(
        self, model: Model, dt: Callable[[], float], start: dict[str, NDArray[np.float64]]
    ) -> None:
        """start: u, v, h, hq_NAME of tracers, vorticity, divergence at the very start, each (N,).

        dt: tells the length of the present step [s].
        """
        self._model, self._dt = model, dt
        self._start = self._integrals(start)
        self._masses = tracer_masses(model.mesh, start, model.scene.tracers or ())

    def __call__(self, moment: Moment) -> dict[str, float]:
        """All numbers at that moment."""
        now = self._integrals(moment.all_fields)
        courant = courant_numbers(self._model.mesh, self._dt(), now)
        tracers = tracer_numbers(self._model.mesh, moment.fields, self._masses)
        return now | drifts(self._start, now) | tracers | courant | self.errors(moment)

    def errors(self, moment: Moment) -> dict[str, float]:
        """Errors against what is known exactly of the scene; NaN at times at which it is not."""
        scene, mesh = self._model.scene, self._model.mesh
        tracers: dict[str, float] = {}
        if scene.exact_tracers is not None:
            exact = scene.exact_tracers(mesh.lon, mesh.lat, moment.time)
            tracers = tracer_errors(mesh, moment.fields, exact)
        return self._flow_errors(moment) | tracers

    def _flow_errors(self, moment: Moment) -> dict[str, float]:
        scene, mesh = self._model.scene, self._model.mesh
        if scene.exact is None:
            return {}
        exact = dict(zip("uvh", scene.exact(mesh.lon, mesh.lat, moment.time), strict=True))
        if scene.wind is not None:  # a prescribed wind has no error to speak of
            exact = {"h": exact["h"]}
        bottom = self._model.bottom if scene.error_field == "surface" else None
        return errors(mesh, moment.fields, exact, bottom)

    def _integrals(self, fields: dict[str, NDArray[np.float64]]) -> dict[str, float]:
        model = self._model
        names = ("u", "v", "h", "vorticity", "divergence")
        values = {name: fields[name] for name in names}
        planet = model.scene.planet
        return integrals(model.mesh, planet, b=model.bottom, f=model.coriolis, **values)


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

    def __call__(self, model: Model, moment: Moment) -> dict[str, float]:
        """l1_h, l2_h, linf_h and, where the reference has a wind, l1_v, l2_v, linf_v."""
        from swe_sphere.io.reference_solution import reference_errors

        fields = moment.all_fields | {"b": model.bottom}
        return {
            f"{norm}_{name}": value
            for name, field in self._fields.items()
            for norm, value in reference_errors(self._path, model.mesh, fields, field).items()
        }
