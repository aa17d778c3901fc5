"""The penalty on jumps of vorticity and divergence at the edges of elements."""

import functools

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.kernels import Terms
from swe_sphere.kernels.assembly import assemble_blocks, finish_rates
from swe_sphere.kernels.diffusion import derivatives, weak_form
from swe_sphere.kernels.local import field_kernel
from swe_sphere.kernels.pointwise import NO_POINTWISE, pointwise_sum
from swe_sphere.operators.device_mesh import DeviceMesh
from swe_sphere.operators.diagnose import assemble
from swe_sphere.operators.launch import MOST_CACHED


class EdgePenaltyOperator:
    """Adds the penalty of the wind of a state to another wind.

    The coefficient gamma of an element is `strength` (E,) [m2 s-1], see `kernels/diffusion.py`.
    """

    def __init__(self, mesh: DeviceMesh, strength: Array) -> None:
        self._mesh, terms, direct = mesh, Terms(jumps=True), mesh.lanes > 1
        types = mesh.types(terms=terms, point=pointwise_sum(2, NO_POINTWISE) if direct else None)
        self._derivatives = field_kernel(types, derivatives)
        self._weak_form = field_kernel(types, weak_form, finish_rates(types, 2) if direct else None)
        mesh.launch.load(self._derivatives, self._weak_form)
        at_edge = np.pad(np.zeros((mesh.mesh.np - 2,) * 2), 1, constant_values=1.0)
        gamma = strength[:, None, None] * at_edge
        weight = assemble(mesh.mesh, gamma * mesh.mesh.quadrature * mesh.mesh.jacobian)
        total, none = weight * mesh.mesh.area, np.zeros_like(weight)
        self._mean_scale = mesh.scatter(np.divide(1.0, total, where=weight > 0.0, out=none))
        self._values, self._weak = mesh.local(2, types.value), mesh.local(2, types.value)
        self._means = wp.zeros(2 * mesh.size, dtype=mesh.real, device=mesh.device)
        given = {
            "strength": mesh.on_elements(gamma[mesh.part.element_numbers]),
            "values": self._values.values,
            "point": types.point and types.point.structure.find(types)(), "stage": mesh.stage,
        }  # fmt: skip
        self._geometry = mesh.geometry(types.geometry, given)
        given = given | {"derivative": mesh.upload(np.ascontiguousarray(mesh.mesh.derivative.T))}
        self._geometry_of = functools.lru_cache(MOST_CACHED)(
            lambda stage: mesh.geometry(types.geometry, given | {"stage": stage})
        )
        """Function from a stage to the geometry that contains it, the same object each time."""
        self._sum_means = mesh.over_nodes(assemble_blocks, int(np.sum(mesh.part.counts == 1)))
        self._sum = mesh.over_nodes(assemble_blocks, mesh.inner if direct else 0)

    def __call__(self, x: wp.array, factor: float, out: wp.array, start: wp.array) -> None:
        """Set the wind of `out` to start's wind plus `factor` [s] times the penalty of x's wind.

        All three may be the same array.
        """
        mesh, means = self._mesh, self._means
        threads, values, weak = mesh.threads(1), self._values, self._weak
        places, layout = mesh.places(2), (mesh.lanes, mesh.size, 2, 0)
        stage = mesh.stage_at(start, factor)
        inputs = self._geometry, x, x, 0, 1, values.values, x
        mesh.over_elements(values, self._derivatives, threads, *inputs, wait=False)
        self._sum_means(places, self._mean_scale, *layout, values.flat, mesh.stage, means)
        inputs = self._geometry_of(stage), means, means, 0, 1, weak.values, out
        mesh.over_elements(weak, self._weak_form, threads, *inputs, wait=False)
        self._sum(places, mesh.inverse_area, *layout, weak.flat, stage, out)
