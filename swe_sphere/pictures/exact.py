"""The exact solution of a scene in the place of a second file."""

from __future__ import annotations

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
from swe_sphere.io.layout import TRACER
from swe_sphere.io.scalar_fields import derive
from swe_sphere.mesh import Interpolator, Mesh
from swe_sphere.operators.diagnose import divergence, vorticity
from swe_sphere.planet import DAY

DERIVATIVES = {"vorticity": vorticity, "divergence": divergence}


class Exact:
    """Fields of the exact solution of a scene anywhere; ConfigError if it has none.

    mesh: on which derivatives of the exact wind are taken, as those of the run are.
    """

    def __init__(self, scene: Scene, mesh: Mesh) -> None:
        if scene.exact is None and scene.exact_tracers is None:
            raise ConfigError(f"no exact solution of {scene.name} is known: compare with a file")
        self._scene, self._mesh = scene, mesh

    def nearest(self, time: float | None) -> float | None:
        """Any time will do."""
        return time

    def at(self, field: str, lon: Array, lat: Array, time: float | None = None) -> Array:
        """A field at points lon, lat (M,) [rad]: (M,); ConfigError where it is not known."""
        time = time or 0.0
        if field in DERIVATIVES:
            u, v, _ = self._flow(self._mesh.lon, self._mesh.lat, time)
            nodal = DERIVATIVES[field](self._mesh, u, v)
            found = Interpolator(self._mesh, lon, lat)(nodal)
        elif field.startswith(TRACER):
            found = self._ratio(field.removeprefix(TRACER), lon, lat, time)
        else:
            u, v, h = self._flow(lon, lat, time)
            bottom = 0.0 * lon if self._scene.bottom is None else self._scene.bottom(lon, lat)
            found = derive({"u": u, "v": v, "h": h, "b": bottom}, field)
        if np.isnan(found).all():
            raise ConfigError(f"{field} of {self._scene.name} is not known at day {time / DAY:g}")
        return found

    def _flow(self, lon: Array, lat: Array, time: float) -> tuple[Array, Array, Array]:
        if self._scene.exact is None:
            raise ConfigError(f"of {self._scene.name} only tracers are known: name one")
        return self._scene.exact(lon, lat, time)

    def _ratio(self, name: str, lon: Array, lat: Array, time: float) -> Array:
        known = self._scene.exact_tracers
        if known is None or name not in (ratios := known(lon, lat, time)):
            raise ConfigError(f"no exact mixing ratio of {name!r} is known: compare with a file")
        ratio: Array = ratios[name]
        return ratio
