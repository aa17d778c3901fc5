"""Preconditioning by sparse factors of the whole Jacobian, advection included."""

import math

import numpy as np
import scipy
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.equations.model import Model
from swe_sphere.mesh.partition import dissection_order
from swe_sphere.operators.sparse import Probing
from swe_sphere.solvers.preconditioners.preconditioner import DEPTH_CHANGE, LaggedPreconditioner

COURANT_CHANGE = 2.0
"""Change of wind, as an advective Courant number of tau, above which new factors pay off."""
FIELDS = 3


class JacobianDirect(LaggedPreconditioner):
    """(I - tau J)^-1 by sparse LU on the host, in float32, J found by probing.

    J excludes viscosity, hyperviscosity and edge penalty. It is nearly skew in the energy norm, so
    that I - tau J needs no pivots, and nodes in the order of nested dissection give small factors.
    """

    name = "jacobian-direct"

    def __init__(self, model: Model) -> None:
        super().__init__(model)
        mesh = model.mesh
        self._probing = Probing(mesh)
        self._spacing = model.device_mesh.on_rank(np.sqrt(mesh.area))
        self._order = (dissection_order(mesh)[:, None] + mesh.size * np.arange(FIELDS)).ravel()
        self._jacobian = model.inviscid.jacobian()
        self._direction, self._image = model.zeros(), model.zeros()

    @classmethod
    def memory_of_factors(cls, nodes: int, np: int) -> float:
        """Return a measured upper estimate of the factors' memory [bytes] for `nodes` nodes."""
        return (330.0 * math.log2(nodes) + 1900.0 * np) * nodes

    def _is_near(self, flow: wp.array) -> bool:
        mesh = self._model.device_mesh
        u, v, h = mesh.on_rank(self._flow).reshape(FIELDS, -1)
        now_u, now_v, now_h = flow.numpy().reshape(FIELDS, -1)
        courant = self._tau * float((np.hypot(now_u - u, now_v - v) / self._spacing).max())
        near = bool(np.all(np.abs(now_h - h) <= DEPTH_CHANGE * np.abs(now_h)))
        return bool(mesh.comm.allgather_number(courant <= COURANT_CHANGE and near).all())

    def _prepare(self, tau: float, flow: Array) -> None:
        self._place(flow, self._direction)
        self._jacobian.update(self._direction, 0.0)
        jacobian = self._probing.matrix(self._product, FIELDS)
        matrix = (scipy.sparse.eye_array(flow.size) - tau * jacobian).tocsr()[self._order]
        matrix = matrix[:, self._order].tocsc().astype(np.float32)
        self._factors = scipy.sparse.linalg.splu(
            matrix, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )

    def _product(self, direction: Array) -> Array:
        self._place(direction, self._direction)
        self._jacobian(self._direction, self._image)
        return self._model.device_mesh.collect(self._image[: self._model.fluid_size])

    def apply(self, r: wp.array, out: wp.array) -> None:
        fluid = self._model.device_mesh.collect(r[: self._model.fluid_size])
        solution = np.empty_like(fluid)
        solution[self._order] = self._factors.solve(fluid[self._order].astype(np.float32))
        self._place(solution, out)

    def _place(self, fluid: Array, state: wp.array) -> None:
        """Store wind and depth at the front of a state."""
        self._model.device_mesh.write(self._model.device_mesh.on_rank(fluid), state)
