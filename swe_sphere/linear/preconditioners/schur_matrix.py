"""The Schur complement as sparse matrices on the host, for diagonals, coarse levels and patches."""

import functools

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...mesh import Mesh
from ...operators import sparse
from .chebyshev import spectral_bound

Array = NDArray[np.float64]


class SchurMatrix:
    """S = I - tau^2 g D H T G on a mesh; G is built once, and D is minus its adjoint."""

    def __init__(self, mesh: Mesh, gravity: float, coriolis: Array) -> None:
        self.mesh, self.gravity, self.coriolis = mesh, gravity, coriolis

    @functools.cached_property
    def gradient(self) -> sp.csr_matrix:
        """G (2N, N) [m-1]."""
        return sparse.gradient(self.mesh)

    def divergence(self, wind: Array) -> Array:
        """D (N,) [s-1] of a wind (2N,) [m s-1]."""
        fluxes: Array = self.gradient.T @ (np.tile(self.mesh.area, 2) * wind)
        return -fluxes / self.mesh.area

    def weight(self, tau: float, depth: Array) -> Array:
        """H/(1 + tau^2 f^2) (N,) [m]: the symmetric part of H T."""
        return depth / (1.0 + (tau * self.coriolis) ** 2)

    def diagonal(self, tau: float, depth: Array) -> Array:
        """Diagonal of S (N,)."""
        slopes, area = self.gradient, self.mesh.area
        squares = sp.csr_array((slopes.data**2, slopes.indices, slopes.indptr), slopes.shape)
        rates: Array = squares.T @ np.tile(area * self.weight(tau, depth), 2) / area
        return 1.0 + tau**2 * self.gravity * rates

    def matrix(self, tau: float, depth: Array) -> sp.csr_matrix:
        """S (N, N)."""
        angle = tau * self.coriolis
        same = sp.diags_array(depth / (1.0 + angle**2))
        cross = sp.diags_array(depth * angle / (1.0 + angle**2))
        turn = sp.block_array([[same, cross], [-cross, same]], format="csr")
        product = sparse.divergence(self.mesh) @ (turn @ self.gradient)
        return (sp.eye_array(self.mesh.size) - tau**2 * self.gravity * product).tocsr()

    def galerkin(
        self, mass: sp.csr_matrix, slopes: sp.csr_matrix, tau: float, depth: Array
    ) -> sp.csr_matrix:
        """B^T M S B of the symmetric part of S for a basis B, with M the areas.

        mass = B^T M B and slopes = G B.
        """
        weight = self.mesh.area * self.weight(tau, depth)
        stiffness = slopes.T @ (sp.diags_array(np.tile(weight, 2)) @ slopes)
        return (mass + tau**2 * self.gravity * stiffness).tocsr()

    def largest_eigenvalue(self, tau: float, depth: Array) -> float:
        """Bound on the spectrum of S over its diagonal."""
        weight = np.tile(self.weight(tau, depth), 2)
        inverse, factor = 1.0 / self.diagonal(tau, depth), tau**2 * self.gravity

        def product(x: Array) -> Array:
            waves = self.divergence(weight * (self.gradient @ x))
            return inverse * (x - factor * waves)

        return spectral_bound(product, self.mesh.size)
