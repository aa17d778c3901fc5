"""The Schur complement as sparse matrices on the host, for diagonals, coarse levels and patches."""

from __future__ import annotations

import numpy as np
import scipy

from swe_sphere.arrays import Array
from swe_sphere.mesh import Mesh
from swe_sphere.operators import sparse
from swe_sphere.operators.column_squares import column_squares


class SchurMatrix:
    """S = I - tau^2 g D H T G on a mesh, G and D the gradient and divergence of the kernels."""

    def __init__(self, mesh: Mesh, gravity: float, coriolis: Array) -> None:
        self.mesh, self.gravity, self.coriolis = mesh, gravity, coriolis

    def weight(self, tau: float, depth: Array) -> Array:
        """H/(1 + tau^2 f^2) (N,) [m]: the symmetric part of H T."""
        return depth / (1.0 + (tau * self.coriolis) ** 2)

    def diagonal(self, tau: float, depth: Array) -> Array:
        """Diagonal of S (N,)."""
        squares = column_squares(self.mesh, self.mesh.area * self.weight(tau, depth))
        return 1.0 + tau**2 * self.gravity * squares / self.mesh.area

    def matrix(self, tau: float, depth: Array) -> scipy.sparse.csr_matrix:
        """S (N, N)."""
        angle = tau * self.coriolis
        same = scipy.sparse.diags_array(depth / (1.0 + angle**2))
        cross = scipy.sparse.diags_array(depth * angle / (1.0 + angle**2))
        turn = scipy.sparse.block_array([[same, cross], [-cross, same]], format="csr")
        product = sparse.divergence(self.mesh) @ (turn @ sparse.gradient(self.mesh))
        return (scipy.sparse.eye_array(self.mesh.size) - tau**2 * self.gravity * product).tocsr()

    def galerkin(
        self,
        mass: scipy.sparse.csr_matrix,
        slopes: scipy.sparse.csr_matrix,
        tau: float,
        depth: Array,
    ) -> scipy.sparse.csr_matrix:
        """B^T M S B of the symmetric part of S for a basis B, with M the areas.

        mass = B^T M B and slopes = G B (2N, V).
        """
        weight = (self.mesh.area * self.weight(tau, depth)).astype(slopes.dtype)
        stiffness = slopes.T @ (scipy.sparse.diags_array(np.tile(weight, 2)) @ slopes)
        return (mass + tau**2 * self.gravity * stiffness).tocsr()
