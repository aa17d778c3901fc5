"""The penalty on jumps of vorticity and divergence at the edges of elements."""

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.kernels.penalty import penalty_kernels
from swe_sphere.operators.device_mesh import DeviceMesh
from swe_sphere.operators.diagnose import assemble
from swe_sphere.operators.launch import Launcher


class EdgePenaltyOperator:
    """Adds the penalty of the wind of a state to a rate of change.

    The coefficient gamma of an element is `strength` (E,) [m2 s-1], see `kernels/penalty.py`.
    """

    def __init__(self, mesh: DeviceMesh, launch: Launcher, strength: Array) -> None:
        self._mesh, self._launch = mesh, launch
        self._kernels = made = penalty_kernels(mesh.mesh.np, mesh.real, mesh.shape)
        at_edge = np.ones((mesh.mesh.np, mesh.mesh.np))
        at_edge[1:-1, 1:-1] = 0.0
        gamma = strength[:, None, None] * at_edge
        weight = assemble(mesh.mesh, gamma * mesh.mesh.quadrature * mesh.mesh.jacobian)
        scale = np.divide(
            1.0, weight * mesh.mesh.area, where=weight > 0.0, out=np.zeros_like(weight)
        )
        self._mean_scale = mesh.scatter(scale)
        self._jumps, self._weak = mesh.local(2, made.value), mesh.local(2, made.value)
        self._means = wp.zeros(2 * mesh.size, dtype=mesh.real, device=mesh.device)
        given = {
            "strength": mesh.on_elements(gamma[mesh.part.elements]), "jumps": self._jumps.values,
        }  # fmt: skip
        transposed = mesh.upload(np.ascontiguousarray(mesh.mesh.derivative.T))
        self._geometry = mesh.geometry(made.geometry, given)
        self._transposed = mesh.geometry(made.geometry, given | {"derivative": transposed})
        launch.load(made.derivatives, made.penalty, made.mean, made.add)

    def __call__(self, x: wp.array, factor: float, out: wp.array) -> None:
        """Add `factor` times the penalty of the wind of x to the wind of `out`."""
        mesh, made, jumps, weak = self._mesh, self._kernels, self._jumps, self._weak
        places, stride, launch = mesh.places(2), mesh.lanes, self._launch
        mesh.sweep(launch, jumps)(
            made.derivatives, mesh.threads(1), self._geometry, x, x, 0, 1, jumps.values, x
        )
        launch(
            made.mean, mesh.size, places, self._mean_scale, stride, jumps.flat, mesh.size,
            self._means,
        )  # fmt: skip
        means = self._means
        mesh.sweep(launch, weak)(
            made.penalty, mesh.threads(1), self._transposed, means, means, 0, 1, weak.values, means
        )
        launch(
            made.add, mesh.size, places, mesh.inverse_area, stride, weak.flat, mesh.size, factor,
            out,
        )  # fmt: skip
