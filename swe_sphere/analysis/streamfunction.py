"""The streamfunction of a wind, in the space of the spectral elements."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from swe_sphere.arrays import Array
from swe_sphere.mesh import Mesh


class Poisson:
    """Finds ψ with k × ∇ψ nearest to a wind, in the mean square over the elements' nodes.

    That is ∇²ψ = ζ in its weak form, ∫ ∇φ·∇ψ = ∫ ∇φ·(v, -u) for every continuous φ of the
    elements; the vorticity itself is not needed.  The matrix is factored once.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._nodes, self._mean = mesh.nodes.ravel(), mesh.area / mesh.area.sum()
        weights = mesh.jacobian * mesh.quadrature
        slopes = _slopes(mesh)
        self._against_slopes = [(sparse.diags_array(weights.ravel()) @ x).T for x in slopes]
        stiffness = sum(w @ x for w, x in zip(self._against_slopes, slopes, strict=True))
        # without its first node, as ψ is known but for a constant
        self._solve = splu(
            sparse.csc_array(stiffness)[1:, 1:], permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0, options={"SymmetricMode": True},
        ).solve  # fmt: skip

    def __call__(self, u: Array, v: Array) -> Array:
        """ψ [m2 s-1] (N,) of mean zero, for the wind u, v (N,) [m s-1]."""
        east, north = self._against_slopes
        right = east @ v[self._nodes] - north @ u[self._nodes]
        found = np.concatenate([[0.0], self._solve(right[1:])])
        result: Array = found - self._mean @ found
        return result


def _slopes(mesh: Mesh) -> tuple[sparse.csr_array, sparse.csr_array]:
    """Derivatives (E np², N) [m-1] along east and north at the nodes of each element."""
    numbers, points = mesh.nodes, mesh.np
    inverse = np.linalg.inv(mesh.basis)  # d xi_i / dx along each axis of the frame
    flat = np.eye(points)
    along = [np.kron(mesh.derivative, flat), np.kron(flat, mesh.derivative)]
    columns = np.repeat(numbers.reshape(-1, points**2), points**2, axis=0)
    starts = np.arange(numbers.size + 1) * points**2

    def slope(axis: int) -> sparse.csr_array:
        local = inverse[..., axis, :].reshape(-1, points**2, 2)
        values = local[..., :1] * along[0] + local[..., 1:] * along[1]
        entries = (values.ravel(), columns.ravel(), starts)
        matrix = sparse.csr_array(entries, shape=(numbers.size, mesh.size), copy=True)
        matrix.eliminate_zeros()  # most of them: a slope runs along two lines of nodes
        return matrix

    return slope(0), slope(1)
