"""What a scene prescribes as functions of time: the wind and the forcing, on the device."""

from collections.abc import Sequence

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.equations.discrete_scene import DiscreteScene


class PrescribedFields:
    """Fields on the device that are evaluated on the host, and only when the time changes."""

    def __init__(
        self, discrete: DiscreteScene, name: str, blocks: Sequence[str], steady: bool
    ) -> None:
        """name: of the scene's function, and of the parameter with the blocks (N,) of its results,
        if there is one; steady: once is enough."""
        self._discrete, self._blocks = discrete, blocks
        self._formula = getattr(discrete.scene, name)
        self._target: wp.array | None = discrete.parameters.get(name)
        self.steady = steady or self._target is None
        """Whether they are the same at all times."""
        self._time: float | None = None
        self.mean_of_depth = 0.0
        """Mean over the sphere of what is prescribed for the depth."""

    def set_time(self, t: float) -> None:
        """Bring the fields to time t [s], unless they are there already."""
        if self._target is None or t == self._time:
            return
        if self._time is None or not self.steady:
            wp.copy(self._target, self._discrete.device_mesh.scatter(self._evaluate(t)))
        self._time = t

    def _evaluate(self, t: float) -> Array:
        mesh = self._discrete.mesh
        fields = dict(zip("uvh", self._formula(mesh.lon, mesh.lat, t), strict=False))
        if "h" in fields:
            self.mean_of_depth = float(np.average(fields["h"], weights=mesh.area))
        return np.concatenate([fields[name] for name in self._blocks])
