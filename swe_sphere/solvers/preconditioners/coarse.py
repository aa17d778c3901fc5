"""Coarse correction on the element vertices: the sum of one solve for each family of waves."""

from __future__ import annotations  # scipy.sparse is loaded where it is used

from typing import Any

import numpy as np
import scipy
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.mesh import Mesh
from swe_sphere.mesh.interpolate import Interpolator
from swe_sphere.operators import sparse
from swe_sphere.operators.device_mesh import Field
from swe_sphere.operators.halo import Halo
from swe_sphere.operators.lane_matrices import SlicedMatrix, TallMatrix, vector
from swe_sphere.operators.schur import SchurMatrix, SchurOperator
from swe_sphere.operators.sparse import ElementSpace
from swe_sphere.solvers.preconditioners.chebyshev import chebyshev_coefficients, spectral_bound
from swe_sphere.solvers.preconditioners.coarse_part import CoarsePart
from swe_sphere.solvers.preconditioners.computational_modes import coarse_spaces, interpolation

Step = tuple[float, float, float]

SWEEPS = 6
"""Number of Chebyshev steps on the coarse functions.  After some days of a run the computational
modes limit the convergence: three steps need half as many iterations again."""
NEGLIGIBLE = 0.02
"""Size of omitted couplings of computational modes, relative to the diagonal."""
SPACING = 12
"""Number of cells of smooth functions along an element of the coarsest mesh (three nodes)."""


class CoarseCorrection:
    """x += sum over the spaces of P_k S_k^-1 P_k^T M b, all inverses by Chebyshev steps.

    The smooth waves have the compact Helmholtz operator, the computational modes the Galerkin
    operators of S. The longest smooth waves are first solved for exactly, on a mesh so coarse that
    a dense inverse suffices; with `symmetric` once more at the end.
    """

    def __init__(
        self, schur: SchurMatrix, operator: SchurOperator, symmetric: bool = False
    ) -> None:
        mesh, spaces = schur.mesh, coarse_spaces(schur.mesh)
        self._schur, self._operator, self._symmetric = schur, operator, symmetric
        self._hats = spaces[0]
        area = scipy.sparse.diags_array(mesh.area)
        bases = [interpolation(mesh, space) for space in spaces]
        self._mass, *masses = [(basis.T @ (area @ basis)).tocsr() for basis in bases]
        slopes = [sparse.slopes(mesh, space).astype(np.float32) for space in spaces[1:]]
        self._modes = list(zip(masses, slopes, strict=True))
        self._longest = longest_waves(mesh, bases[0])
        count, (smooth, few) = sum(basis.shape[1] for basis in bases), self._longest.shape
        self._part = CoarsePart(operator, spaces, _reach(spaces[0], slopes))
        size = self._part.functions.size
        self._b, self._r, self._d, self._new, self._found = (
            vector(operator.mesh, size) for _ in range(5)
        )
        self._few = vector(operator.mesh, few), vector(operator.mesh, few)
        here = self._part.rows(_filled(self._longest, (count, few)))
        self._spread = TallMatrix(operator.mesh, operator.launch, here)
        self._gather = TallMatrix(operator.mesh, operator.launch, self._longest).transposed
        self._smooth_r = self._r
        if operator.mesh.comm.shared:
            comm, self._smooth_r = operator.mesh.comm, vector(operator.mesh, smooth)
            mine = self._part.owned(np.arange(smooth))
            owned = {rank: each for rank, each in enumerate(comm.tell_all(mine)) if each.size}
            sends = dict.fromkeys(range(comm.size) if mine.size else (), self._part.here(mine))
            self._join = Halo(comm, self._r.flat, sends, owned, self._smooth_r.flat)
            """The residual of all smooth functions, each from the rank that owns it."""
            ring = self._part.ring()
            for each in (self._d, self._new, self._found)[: 2 + symmetric]:
                operator.mesh.share(each.flat, *ring)

    def setup(self, tau: float, depth: Array) -> None:
        """Build the coarse operators for the implicit step tau [s] and the depth (N,) [m]."""
        schur, longest = self._schur, self._longest
        compact = sparse.stiffness(schur.mesh, schur.weight(tau, depth), self._hats)
        smooth = self._mass + tau**2 * schur.gravity * compact
        blocks = [schur.galerkin(mass, slopes, tau, depth) for mass, slopes in self._modes]
        modes = _without_small(scipy.sparse.block_diag(blocks, format="coo"))
        matrix = scipy.sparse.block_diag([smooth, modes], format="csr", dtype=np.float32)
        del compact, blocks, modes  # the memory use of a run peaks here
        inverse = 1.0 / matrix.diagonal()
        largest = spectral_bound(lambda x: inverse * (matrix @ x), inverse.size)
        self._coefficients = chebyshev_coefficients(SWEEPS, largest)
        exact = np.linalg.pinv((longest.T @ smooth @ longest).toarray(), 1e-10, hermitian=True)
        mesh, launch = self._operator.mesh, self._operator.launch
        self._exact = TallMatrix(mesh, launch, scipy.sparse.csr_array(exact))
        self._smooth, self._matrix = (
            SlicedMatrix(mesh, launch, self._part.square(each))
            for each in (_filled(smooth, matrix.shape), matrix)
        )
        inverse = inverse[self._part.functions]
        self._per_diagonal = vector(self._operator.mesh, inverse.size)
        self._operator.mesh.write(inverse, self._per_diagonal.flat)

    def correct(self, b: Field, x: Field, add: bool = True) -> None:
        """Add the correction for the residual b to x, or set x to it."""
        found, d, new = self._found, self._d, self._new
        exchange = self._operator.mesh.exchange
        self._part.restrict(b, self._b)
        wp.copy(self._r.values, self._b.values)
        self._solve_longest(d, add=False)
        before, product = d, self._smooth
        for left, coefficients in zip(range(SWEEPS)[::-1], self._coefficients, strict=True):
            self._sweep(product, coefficients, d, new, before)
            if left:
                exchange(new)
            before, d, new, product = found, new, d, self._matrix
        if self._symmetric:
            exchange(found)
            wp.copy(self._r.values, self._b.values)
            self._sweep(self._smooth, (0.0, 0.0, 0.0), found, new, found)
            self._solve_longest(found, add=True)
        if not add:
            x.values.zero_()
        self._part.prolong(found, x)

    def _sweep(
        self, product: SlicedMatrix, coefficients: Step, d: Field, new: Field, before: Field
    ) -> None:
        """Update the coefficients of all functions by a Chebyshev step from `before`."""
        per_diagonal = self._per_diagonal.values
        product.sweep(coefficients, per_diagonal, self._r, (d, new), before, self._found)

    def _solve_longest(self, out: Field, add: bool) -> None:
        """Set out = P A^-1 P^T r for the longest waves, or add it to out."""
        once, twice = self._few
        if self._smooth_r is not self._r:
            self._join()
        self._gather(self._smooth_r, once)
        self._exact(once, twice)
        self._spread(twice, out, add)


def longest_waves(mesh: Mesh, smooth: scipy.sparse.csr_array) -> scipy.sparse.csr_array:
    """Return values (V, m) of a coarse mesh's nodal functions at the vertices of smooth functions.

    smooth: (N, V) nodal values of the smooth functions, each 1 at its own vertex.
    """
    per_edge = np.sqrt((smooth.shape[1] - 2) / 6.0)
    ne = max(1, round(per_edge / SPACING))
    coarse = Mesh.build(ne, 3, mesh.radius, mesh.stretch, mesh.centre, mesh.spin)
    at = smooth.tocsc().argmax(axis=0)
    return Interpolator(coarse, mesh.lon[at], mesh.lat[at]).matrix


def _filled(matrix: scipy.sparse.csr_array, shape: tuple[int, int]) -> scipy.sparse.csr_array:
    """Return the matrix with empty rows and columns appended."""
    wider = scipy.sparse.csr_array(matrix, copy=True)
    wider.resize(shape)
    return wider


def _reach(smooth: ElementSpace, slopes: list[Any]) -> scipy.sparse.csr_array:
    """Coupling: smooth functions meet in an element, others if both have slopes there."""
    element, function = np.indices(smooth.numbers.shape)[0].ravel(), smooth.numbers.ravel()
    of_elements = scipy.sparse.csr_array((np.ones(element.size), (element, function)))
    return scipy.sparse.block_diag([of_elements, *slopes], format="csr")


def _without_small(matrix: scipy.sparse.coo_array) -> scipy.sparse.csr_array:
    """Return the matrix without entries that are NEGLIGIBLE relative to the diagonal."""
    scale = np.sqrt(matrix.diagonal())
    kept = np.abs(matrix.data) > NEGLIGIBLE * scale[matrix.row] * scale[matrix.col]
    entries = matrix.data[kept], (matrix.row[kept], matrix.col[kept])
    return scipy.sparse.csr_array(entries, shape=matrix.shape)
