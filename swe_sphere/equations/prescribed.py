"""What a scene prescribes as functions of time: the wind and the forcing, on the device."""

from abc import ABC, abstractmethod

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.discrete_scene import DiscreteScene

Array = NDArray[np.float64]


class PrescribedField(ABC):
    """Fields on the device that are evaluated on the host, and only when the time changes."""

    def __init__(self, discrete: DiscreteScene, name: str, steady: bool) -> None:
        """name: of the parameter that they fill, if there is one; steady: once is enough."""
        self._discrete, self._steady = discrete, steady
        self._target: wp.array | None = discrete.parameters.get(name)
        self._time: float | None = None

    def set_time(self, t: float) -> None:
        """Bring the fields to time t [s], unless they are there already."""
        if self._target is None or t == self._time:
            return
        if self._time is None or not self._steady:
            wp.copy(self._target, self._discrete.device_mesh.upload(self._evaluate(t)))
        self._time = t

    @abstractmethod
    def _evaluate(self, t: float) -> Array: ...


class WindField(PrescribedField):
    """The prescribed wind (2N,) [m s-1]."""

    def __init__(self, discrete: DiscreteScene) -> None:
        super().__init__(discrete, "wind", discrete.scene.steady_wind)

    def _evaluate(self, t: float) -> Array:
        mesh, scene = self._discrete.mesh, self._discrete.scene
        assert scene.wind is not None
        return np.concatenate(scene.wind(mesh.lon, mesh.lat, t))


class ForcingField(PrescribedField):
    """The forcing of wind and depth, as far as they are stepped (unknowns*N,)."""

    def __init__(self, discrete: DiscreteScene) -> None:
        super().__init__(discrete, "forcing", discrete.scene.steady_forcing)
        self.mean_depth_rate = 0.0
        """Mean over the sphere of the prescribed rate of change of depth [m s-1]."""

    def _evaluate(self, t: float) -> Array:
        mesh, scene = self._discrete.mesh, self._discrete.scene
        assert scene.forcing is not None
        rates = dict(zip("uvh", scene.forcing(mesh.lon, mesh.lat, t), strict=True))
        self.mean_depth_rate = float(np.average(rates["h"], weights=mesh.area))
        return np.concatenate([rates[name] for name in self._discrete.fluid])
