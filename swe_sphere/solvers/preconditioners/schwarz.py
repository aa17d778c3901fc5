"""Preconditioning by block elimination, with the Schur complement inverted patch by patch."""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.equations.model import Model
from swe_sphere.kernels.coarse import patch_kernel
from swe_sphere.operators.device_mesh import Field
from swe_sphere.solvers.preconditioners.block_elimination import BlockElimination
from swe_sphere.solvers.preconditioners.preconditioner import refuse_if_large


class SchwarzElimination(BlockElimination):
    """The Schur complement by overlapping patches.

    Each element solves on itself and its neighbours and keeps the values of its own nodes.

    The rows of the patch inverses that are kept are computed once, so that a sweep is a product
    with a sparse matrix of fixed row length (Cai & Sarkis 1999, doi:10.1137/S106482759732678X).
    """

    name = "helmholtz-schwarz"

    def __init__(self, model: Model) -> None:
        memory = self.memory_of_factors(model.mesh.size, model.mesh.np)
        refuse_if_large(memory, "the patch inverses", self.name)
        super().__init__(model)

    @classmethod
    def memory_of_factors(cls, nodes: int, np: int) -> float:
        """Memory [bytes] of the patch inverses for a mesh of so many nodes."""
        return 8.0 * nodes * _longest(np)

    def invert(self, tau: float, depth: Array) -> None:
        """Invert the patches for the implicit step tau [s] and the depth (N,) [m]."""
        mesh, longest = self.matrix.mesh, _longest(self.matrix.mesh.np)
        matrix = self.matrix.matrix(tau, depth)
        columns = np.zeros((mesh.size, longest), dtype=np.int32)
        rows = np.zeros((mesh.size, longest), dtype=np.float32)
        owner = mesh.gather_entries[mesh.gather_offsets[:-1]] // mesh.np**2
        owned = np.argsort(owner, kind="stable")
        bounds = np.searchsorted(owner[owned], np.arange(mesh.elements + 1))
        for e, patch in enumerate(self._patches()):
            mine = owned[bounds[e] : bounds[e + 1]]
            inverse = np.linalg.inv(matrix[patch][:, patch].toarray())
            columns[mine, : len(patch)] = patch
            rows[mine, : len(patch)] = inverse[np.searchsorted(patch, mine)]
        operator, nodes = self.operator, self.operator.mesh.part.nodes
        columns, rows = columns[nodes], rows[nodes]
        self._kernel = patch_kernel(operator.mesh.real)
        self._columns = wp.array(columns, dtype=wp.int32, device=operator.mesh.device)
        self._rows = wp.array(rows, dtype=wp.float32, device=operator.mesh.device)
        self._right, self._x = (
            wp.zeros(operator.size, dtype=operator.mesh.real, device=operator.mesh.device)
            for _ in range(2)
        )
        operator.launch.load(self._kernel)

    def solve(self, b: Field, x: Field) -> None:
        """x = one sweep for b."""
        operator = self.operator
        operator.collect(b, self._right)
        right = self._right
        if operator.mesh.comm.shared:  # patches reach over the rim
            right = operator.mesh.upload(operator.mesh.collect(right))
        operator.launch(self._kernel, operator.size, self._columns, self._rows, right, self._x)
        operator.spread(self._x, x)

    def _patches(self) -> list[NDArray[np.int64]]:
        """Nodes of each element and of the elements that share a node with it, ascending."""
        mesh = self.matrix.mesh
        nodes = mesh.nodes.reshape(mesh.elements, -1)
        elements = mesh.gather_entries // mesh.np**2
        offsets = mesh.gather_offsets
        near = [
            np.unique(np.concatenate([elements[offsets[n] : offsets[n + 1]] for n in row]))
            for row in nodes
        ]
        return [np.unique(nodes[group]) for group in near]


def _longest(np: int) -> int:
    """Nodes of a patch: of an element and the eight around it."""
    return (3 * np - 2) ** 2
