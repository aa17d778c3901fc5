"""The classic Jacobian-free product: a difference of two right-hand sides."""

from typing import TYPE_CHECKING

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.kernels import combine_kernel

if TYPE_CHECKING:
    from swe_sphere.equations.model import Model


class DifferenceProduct:
    """J d near [F(x + e d) - F(x)]/e with e = sqrt(round-off) max|x| / max|d|.

    Knoll & Keyes 2004 (doi:10.1016/j.jcp.2003.08.010), section 2.3, with depth and wind each
    measured by its own largest value.  For comparison, and for effects without a tangent of their
    own: it costs about what the exact product does, but has only half the digits.
    """

    def __init__(self, model: "Model") -> None:
        real = model.device_mesh.real
        self._model, self._one, self._two = model, combine_kernel(real, 1), combine_kernel(real, 2)
        self._base, self._slope, self._moved, self._zero = (model.zeros() for _ in range(4))
        self._root = float(np.sqrt(np.finfo(model.device_mesh.numpy_real).eps))
        self._time, self._sizes = 0.0, np.ones(len(model.names))
        model.launch.load(self._one, self._two)

    def linearise(self, state: wp.array, t: float) -> None:
        """Fix the state and time of the Jacobian; costs one right-hand side."""
        wp.copy(self._base, state)
        self._time, self._sizes = t, self._largest(state)
        self._model.tendency(state, t, self._slope)

    def __call__(self, direction: wp.array, out: wp.array) -> None:
        """out near J direction; costs one right-hand side."""
        relative = float((self._largest(direction) / self._sizes).max())
        if relative == 0.0:
            out.zero_()
            return
        e, launch, size = self._root / relative, self._model.launch, self._model.size
        launch(self._one, size, self._base, direction, e, self._moved)
        self._model.tendency(self._moved, self._time, out)
        launch(self._two, size, self._zero, out, 1.0 / e, self._slope, -1.0 / e, out)

    def _largest(self, state: wp.array) -> NDArray[np.float64]:
        """Largest modulus of the winds together and of each other field, never below a rounding."""
        blocks = np.abs(state.numpy()).reshape(len(self._model.names), -1).max(axis=1)
        if self._model.scene.wind is None:
            blocks[:2] = blocks[:2].max()
        return np.asarray(np.maximum(blocks, np.finfo(np.float32).tiny), dtype=np.float64)
