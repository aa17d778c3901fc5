"""Coarse correction on the element vertices: one solve for each family of waves, added up."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.operators import sparse
from swe_sphere.solvers.preconditioners.chebyshev import chebyshev_coefficients, spectral_bound
from swe_sphere.solvers.preconditioners.computational_modes import coarse_spaces, interpolation
from swe_sphere.solvers.preconditioners.schur_matrix import SchurMatrix

Float32 = NDArray[np.float32]

MODE_SWEEPS = 6
"""Chebyshev steps on the computational modes, whose coarse operators are well conditioned.  Days
into a run these modes limit the convergence: with three steps it takes half as many iterations
again."""
NEGLIGIBLE = 0.01
"""Couplings of computational modes that are left out, relative to the diagonal: one in three."""


class CoarseCorrection:
    """x = sum over the spaces of P_k S_k^-1 P_k^T M b, on the host in float32.

    The smooth waves have the compact Helmholtz operator, factorised; the computational modes have
    the Galerkin operators of S, and a few Chebyshev steps will do.
    """

    def __init__(self, schur: SchurMatrix) -> None:
        mesh = schur.mesh
        functions, area = coarse_spaces(mesh), scipy.sparse.diags_array(mesh.area)
        self._schur, self._hats = schur, functions[0]
        spaces = [interpolation(mesh, function) for function in functions]
        self._mass, *masses = [(space.T @ (area @ space)).tocsr() for space in spaces]
        self._prolongation = scipy.sparse.hstack(
            [s.astype(np.float32) for s in spaces], format="csr"
        )
        del spaces
        restriction = self._prolongation.T.tocsr()
        restriction.data *= mesh.area.astype(np.float32)[restriction.indices]
        self._restriction = restriction
        slopes = [sparse.slopes(mesh, function).astype(np.float32) for function in functions[1:]]
        self._modes = list(zip(masses, slopes, strict=True))

    def setup(self, tau: float, depth: Array) -> None:
        """Coarse operators for the implicit step tau [s] and the depth (N,) [m]."""
        schur = self._schur
        compact = sparse.stiffness(schur.mesh, schur.weight(tau, depth), self._hats)
        smooth = self._mass + tau**2 * schur.gravity * compact
        self._direct = scipy.sparse.linalg.splu(
            smooth.tocsc().astype(np.float32), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )  # fmt: skip
        blocks = [schur.galerkin(mass, slopes, tau, depth) for mass, slopes in self._modes]
        modes = scipy.sparse.block_diag(blocks, format="coo")
        self._matrix = _without_small(modes).astype(np.float32)
        self._inverse = (1.0 / self._matrix.diagonal()).astype(np.float32)
        largest = spectral_bound(lambda x: self._inverse * (self._matrix @ x), self._inverse.size)
        self._coefficients = chebyshev_coefficients(MODE_SWEEPS, largest)

    def solve(self, b: Float32) -> Float32:
        """The correction (N,) for the residual b (N,)."""
        coarse = self._restriction @ b
        split = self._mass.shape[0]
        coarse[:split] = self._direct.solve(coarse[:split])
        coarse[split:] = self._sweep(coarse[split:])
        correction: Float32 = self._prolongation @ coarse
        return correction

    def _sweep(self, r: Float32) -> Float32:
        """Chebyshev steps from zero; r is overwritten."""
        (_, take, beta), *others = self._coefficients
        d = np.float32(take) * (self._inverse * r)
        x: Float32 = np.float32(beta) * d
        for keep, take, beta in others:
            r -= self._matrix @ d
            d = np.float32(keep) * d + np.float32(take) * (self._inverse * r)
            x += np.float32(beta) * d
        return x


def _without_small(matrix: scipy.sparse.coo_array) -> scipy.sparse.csr_array:
    """The matrix without entries that are NEGLIGIBLE beside the diagonal."""
    scale = np.sqrt(matrix.diagonal())
    kept = np.abs(matrix.data) > NEGLIGIBLE * scale[matrix.row] * scale[matrix.col]
    entries = matrix.data[kept], (matrix.row[kept], matrix.col[kept])
    return scipy.sparse.csr_array(entries, shape=matrix.shape)
