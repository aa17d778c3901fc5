"""Of a wind: energy and enstrophy by spherical wavenumber, and the streamfunction."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from swe_sphere.analysis.regrid import Grid, gaussian
from swe_sphere.arrays import Array
from swe_sphere.mesh import Mesh
from swe_sphere.operators.diagnose import vorticity
from swe_sphere.operators.sparse import stiffness
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
    return np.asarray(squares.sum(axis=1))


def poisson(mesh: Mesh) -> Callable[[Array, Array], Array]:
    """Return the function that finds ψ with k × ∇ψ nearest to a wind, in the mean square.

    That is ∇²ψ = ζ in its weak form, ∫ ∇φ·∇ψ = -∫ φ ζ for every continuous φ of the elements.  The
    matrix is factored once.
    """
    # without its first node, as ψ is known but for a constant
    factors = splu(
        sparse.csc_array(stiffness(mesh, np.ones(mesh.size)))[1:, 1:], diag_pivot_thresh=0.0,
        permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True},
    )  # fmt: skip

    def streamfunction(u: Array, v: Array) -> Array:
        """ψ [m2 s-1] (N,) of mean zero, for the wind u, v (N,) [m s-1]."""
        right = -mesh.area * vorticity(mesh, u, v)
        found = np.append(0.0, factors.solve(right[1:]))
        result: Array = found - np.average(found, weights=mesh.area)
        return result

    return streamfunction
