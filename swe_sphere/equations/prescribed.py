"""What a scene gives as functions of time: the prescribed wind and the forcing, on the device."""

from typing import TYPE_CHECKING

import numpy as np
import warp as wp
from numpy.typing import NDArray

if TYPE_CHECKING:
    from swe_sphere.equations.model import Model

Array = NDArray[np.float64]


class Given:
    """Fields on the device that are evaluated on the host, and only when the time changes."""

    def __init__(self, model: "Model", target: wp.array | None, steady: bool) -> None:
        """target: where the fields go, None if the scene has none; steady: once is enough."""
        self._model, self._target, self._steady = model, target, steady
        self._time: float | None = None

    def set_time(self, t: float) -> None:
        """Bring the fields to time t [s], unless they are there already."""
        if self._target is None or t == self._time:
            return
        if self._time is None or not self._steady:
            wp.copy(self._target, self._model.device_mesh.upload(self._evaluate(t)))
        self._time = t

    def _evaluate(self, t: float) -> Array:
        raise NotImplementedError


class GivenWind(Given):
    """The prescribed wind (2N,) [m s-1]."""

    def __init__(self, model: "Model") -> None:
        super().__init__(model, model.parameters.get("wind"), model.scene.steady_wind)

    def _evaluate(self, t: float) -> Array:
        mesh, scene = self._model.mesh, self._model.scene
        assert scene.wind is not None
        return np.concatenate(scene.wind(mesh.lon, mesh.lat, t))


class GivenForcing(Given):
    """The forcing of wind and depth, as far as they are stepped (unknowns*N,)."""

    def __init__(self, model: "Model") -> None:
        super().__init__(model, model.parameters.get("forcing"), model.scene.steady_forcing)
        self.mean_depth_rate = 0.0
        """Mean over the sphere of the given rate of change of depth [m s-1]."""

    def _evaluate(self, t: float) -> Array:
        mesh, model = self._model.mesh, self._model
        assert model.scene.forcing is not None
        rates = dict(zip("uvh", model.scene.forcing(mesh.lon, mesh.lat, t), strict=True))
        self.mean_depth_rate = float(np.average(rates["h"], weights=mesh.area))
        return np.concatenate([rates[name] for name in model.names if name in rates])
