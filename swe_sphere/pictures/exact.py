"""The exact solution of a scene in the place of a second file."""

from __future__ import annotations

from swe_sphere.arrays import Array
from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
from swe_sphere.io.scalar_fields import derive


class Exact:
    """Fields of the exact solution of a scene anywhere; ConfigError if it has none."""

    def __init__(self, scene: Scene) -> None:
        if scene.exact is None:
            raise ConfigError(f"no exact solution of {scene.name} is known: compare with a file")
        self._scene, self._exact = scene, scene.exact

    def nearest(self, time: float | None) -> float | None:
        """Any time will do."""
        return time

    def at(self, field: str, lon: Array, lat: Array, time: float | None = None) -> Array:
        """h, u, v, speed, surface or b at points lon, lat (M,) [rad]: (M,)."""
        u, v, h = self._exact(lon, lat, time or 0.0)
        bottom = 0.0 * lon if self._scene.bottom is None else self._scene.bottom(lon, lat)
        return derive({"u": u, "v": v, "h": h, "b": bottom}, field)
