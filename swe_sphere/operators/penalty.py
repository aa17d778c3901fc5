"""The penalty on jumps of vorticity and divergence at the edges of elements."""

from typing import Any

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.kernels import Terms
from swe_sphere.kernels.assembly import assemble_blocks
from swe_sphere.kernels.diffusion import derivatives, weak_form
from swe_sphere.kernels.local import field_kernel
from swe_sphere.kernels.simd.stages import stage_struct
from swe_sphere.operators.device_mesh import DeviceMesh, Field
from swe_sphere.operators.diagnose import assemble
from swe_sphere.operators.launch import Launcher, in_runs


class EdgePenaltyOperator:
    """Adds the penalty of the wind of a state to a rate of change.

    The coefficient gamma of an element is `strength` (E,) [m2 s-1], see `kernels/diffusion.py`.
    """

    def __init__(self, mesh: DeviceMesh, launch: Launcher, strength: Array) -> None:
        self._mesh, self._launch = mesh, launch
        types = mesh.types(terms=Terms(jumps=True))
        self._derivatives, self._weak_form = kernels = [
            field_kernel(types, formula) for formula in (derivatives, weak_form)
        ]
        launch.load(*kernels)
        at_edge = np.ones((mesh.mesh.np, mesh.mesh.np))
        at_edge[1:-1, 1:-1] = 0.0
        gamma = strength[:, None, None] * at_edge
        weight = assemble(mesh.mesh, gamma * mesh.mesh.quadrature * mesh.mesh.jacobian)
        scale = np.divide(
            1.0, weight * mesh.mesh.area, where=weight > 0.0, out=np.zeros_like(weight)
        )
        self._mean_scale = mesh.scatter(scale)
        self._jumps, self._weak = mesh.local(2, types.value), mesh.local(2, types.value)
        self._means = wp.zeros(2 * mesh.size, dtype=mesh.real, device=mesh.device)
        given = {
            "strength": mesh.on_elements(gamma[mesh.part.elements]), "jumps": self._jumps.values,
        }  # fmt: skip
        transposed = mesh.upload(np.ascontiguousarray(mesh.mesh.derivative.T))
        self._geometry = mesh.geometry(types.geometry, given)
        self._transposed = mesh.geometry(types.geometry, given | {"derivative": transposed})
        self._sums = in_runs(launch, assemble_blocks, mesh.real, mesh.lanes, *mesh.spans())

    def __call__(self, x: wp.array, factor: float, out: wp.array) -> None:
        """Add `factor` times the penalty of the wind of x to the wind of `out`."""
        mesh, means = self._mesh, self._means
        threads, jumps, weak = mesh.threads(1), self._jumps, self._weak
        mesh.sweep(self._launch, jumps)(
            self._derivatives, threads, self._geometry, x, x, 0, 1, jumps.values, x
        )
        self._assemble(self._mean_scale, jumps, mesh.stage, means)
        mesh.sweep(self._launch, weak)(
            self._weak_form, threads, self._transposed, means, means, 0, 1, weak.values, means
        )
        added = stage_struct(mesh.real)()
        added.on, added.start, added.tau = True, out, factor
        self._assemble(mesh.inverse_area, weak, added, out)

    def _assemble(self, scale: wp.array, local: Field, stage: Any, out: wp.array) -> None:
        mesh = self._mesh
        for launch in self._sums:
            launch(mesh.places(2), scale, mesh.lanes, mesh.size, 2, 0, local.flat, stage, out)
