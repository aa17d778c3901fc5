"""Of a wind: energy and enstrophy by spherical wavenumber, and the streamfunction."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from swe_sphere.analysis.grids import Grid, gaussian
from swe_sphere.arrays import Array
from swe_sphere.mesh import Mesh
from swe_sphere.testcases.harmonics import Complex, GaussGrid


def truncation(mesh: Mesh) -> int:
    """The spherical wavenumber whose wave has two nodes along the equator of an even mesh."""
    return 2 * mesh.ne * (mesh.np - 1)


def grid_for(degree: int) -> Grid:
    """The grid on which `spectra` to a degree wants the wind.

    Half as fine again as the degree needs, so that what is finer folds back only beyond it.
    """
    return gaussian((3 * degree + 5) // 4)


def spectra(u: Array, v: Array, degree: int, radius: float) -> Array:
    """Rotational and divergent kinetic energy [m2 s-2] and enstrophy [s-2], (3, degree + 1).

    u, v: wind [m s-1] at the points of `grid_for`.  Means over the sphere: the sum of the first two
    over all wavenumbers n is the mean of (u² + v²) / 2, that of the third the mean of ζ² / 2.  With
    the coefficients of vorticity and divergence the energy is
    a² / (4 n (n + 1)) Σ_m (|ζ_nm|² + |δ_nm|²) (Lambert, 1984, Atmosphere-Ocean 22, eq. 6).
    """
    grid = GaussGrid(u.shape[0] - 1)
    vorticity, divergence = (
        _power(grid.against_gradients(*flux), degree) / radius**2 for flux in ((v, -u), (u, v))
    )
    n = np.arange(degree + 1.0)
    factor = np.divide(radius**2, n * (n + 1.0), out=np.zeros_like(n), where=n > 0)
    return 0.5 * np.stack([factor * vorticity, factor * divergence, vorticity])


def _power(coefficients: Complex, degree: int) -> Array:
    """Mean squares (degree + 1,) of the parts of each degree of a real field."""
    squares = np.abs(coefficients[: degree + 1]) ** 2
    squares[:, 1:] *= 0.5  # a wave has half the square of its amplitude
    found: Array = squares.sum(axis=1)
    return found


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
