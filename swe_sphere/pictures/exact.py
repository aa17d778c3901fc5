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

    def at(self, field: str, lon: Array, lat: Array, time: float | None = None) -> Array:
        """A field at points lon, lat (M,) [rad]: (M,); ConfigError where it is not known."""
        scene, mesh, now = self._scene, self._mesh, time or 0.0
        if field.startswith(TRACER):
            name = field.removeprefix(TRACER)
            known = {} if scene.exact_tracers is None else scene.exact_tracers(lon, lat, now)
            if name not in known:
                raise ConfigError(
                    f"no exact mixing ratio of {name!r} is known: compare with a file"
                )
            found: Array = known[name]
        elif scene.exact is None:
            raise ConfigError(f"of {scene.name} only tracers are known: name one")
        elif field in DERIVATIVES:
            u, v, _ = scene.exact(mesh.lon, mesh.lat, now)
            found = Interpolator(mesh, lon, lat)(DERIVATIVES[field](mesh, u, v))
        else:
            u, v, h = scene.exact(lon, lat, now)
            bottom = 0.0 * lon if scene.bottom is None else scene.bottom(lon, lat)
            found = derive({"u": u, "v": v, "h": h, "b": bottom}, field)
        if np.isnan(found).all():
            raise ConfigError(f"{field} of {scene.name} is not known at day {now / DAY:g}")
        return found
