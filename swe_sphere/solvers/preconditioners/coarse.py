"""Coarse correction on the element vertices: one solve for each family of waves, added up."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy
import warp as wp
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.kernels.coarse import coarse_kernels
from swe_sphere.mesh import Mesh
from swe_sphere.mesh.interpolate import Interpolator
from swe_sphere.operators import sparse
from swe_sphere.operators.field import Field
from swe_sphere.operators.schur import SchurOperator
from swe_sphere.operators.sliced_matrix import SlicedMatrix, vector
from swe_sphere.operators.sparse import ElementSpace
from swe_sphere.solvers.preconditioners.chebyshev import chebyshev_coefficients, spectral_bound
from swe_sphere.solvers.preconditioners.computational_modes import coarse_spaces, interpolation
from swe_sphere.solvers.preconditioners.schur_matrix import SchurMatrix

Step = tuple[float, float, float]

SWEEPS = 6
"""Chebyshev steps on the coarse functions.  Days into a run the computational modes limit the
convergence: with three steps it takes half as many iterations again."""
NEGLIGIBLE = 0.02
"""Couplings of computational modes that are left out, relative to the diagonal."""
SPACING = 12
"""Cells of the smooth functions along an element of the coarsest mesh, which has three nodes."""


class CoarseCorrection:
    """x += sum over the spaces of P_k S_k^-1 P_k^T M b, all inverses by Chebyshev steps.

    The smooth waves have the compact Helmholtz operator, the computational modes the Galerkin
    operators of S.  Of the smooth waves the longest are solved for exactly before, on a mesh so
    coarse that a dense inverse will do; with `symmetric` once more behind.
    """

    def __init__(
        self, schur: SchurMatrix, operator: SchurOperator, symmetric: bool = False
    ) -> None:
        mesh, spaces = schur.mesh, coarse_spaces(schur.mesh)
        self._schur, self._operator, self._symmetric = schur, operator, symmetric
        self._hats = spaces[0]
        self._transfer = Transfer(spaces, operator)
        area = scipy.sparse.diags_array(mesh.area)
        bases = [interpolation(mesh, space) for space in spaces]
        self._mass, *masses = [(basis.T @ (area @ basis)).tocsr() for basis in bases]
        slopes = [sparse.slopes(mesh, space).astype(np.float32) for space in spaces[1:]]
        self._modes = list(zip(masses, slopes, strict=True))
        self._longest = longest_waves(mesh, bases[0])
        count, few = sum(basis.shape[1] for basis in bases), self._longest.shape[1]
        self._r, self._d, self._new = (vector(operator.mesh, count) for _ in range(3))
        self._few = vector(operator.mesh, few), vector(operator.mesh, few)
        self._gather = self._sliced(self._longest.T)
        self._spread = self._sliced(_filled(self._longest, (count, few)))

    def setup(self, tau: float, depth: Array) -> None:
        """Coarse operators for the implicit step tau [s] and the depth (N,) [m]."""
        schur, longest = self._schur, self._longest
        compact = sparse.stiffness(schur.mesh, schur.weight(tau, depth), self._hats)
        smooth = self._mass + tau**2 * schur.gravity * compact
        blocks = [schur.galerkin(mass, slopes, tau, depth) for mass, slopes in self._modes]
        modes = _without_small(scipy.sparse.block_diag(blocks, format="coo"))
        matrix = scipy.sparse.block_diag([smooth, modes], format="csr")
        inverse = 1.0 / matrix.diagonal()
        largest = spectral_bound(lambda x: inverse * (matrix @ x), inverse.size)
        self._coefficients = chebyshev_coefficients(SWEEPS, largest)
        exact = np.linalg.pinv((longest.T @ smooth @ longest).toarray(), 1e-10, hermitian=True)
        self._exact = self._sliced(exact)
        self._smooth = self._sliced(_filled(smooth, matrix.shape))
        self._matrix = self._sliced(matrix)
        self._per_diagonal = vector(self._operator.mesh, inverse.size)
        self._operator.mesh.write(inverse, self._per_diagonal.flat)

    def correct(self, b: Field, x: Field) -> None:
        """Add the correction for the residual b to x."""
        found, d, new = self._transfer.coefficients, self._d, self._new
        self._transfer.restrict(b, self._r)
        self._solve_longest(d, add=False)
        before, product = d, self._smooth
        for coefficients in self._coefficients:
            self._sweep(product, coefficients, d, new, before)
            before, d, new, product = found, new, d, self._matrix
        if self._symmetric:
            self._transfer.restrict(b, self._r)
            self._sweep(self._smooth, (0.0, 0.0, 0.0), found, new, found)
            self._solve_longest(found, add=True)
        self._transfer.prolong(x)

    def _sweep(
        self, product: SlicedMatrix, coefficients: Step, d: Field, new: Field, before: Field
    ) -> None:
        """The coefficients of all functions, from those before, after a Chebyshev step."""
        found, per_diagonal = self._transfer.coefficients, self._per_diagonal.values
        product.sweep(coefficients, per_diagonal, self._r, (d, new), before, found)

    def _solve_longest(self, out: Field, add: bool) -> None:
        """out = P A^-1 P^T r for the longest waves, or that added to it."""
        once, twice = self._few
        self._gather(self._r, once)
        self._exact(once, twice)
        self._spread(twice, out, add)

    def _sliced(self, matrix: Any) -> SlicedMatrix:
        return SlicedMatrix(
            self._operator.mesh, self._operator.launch, scipy.sparse.csr_array(matrix)
        )


class Transfer:
    """Between fields and coefficients of all functions of the spaces, one after the other."""

    def __init__(self, spaces: list[ElementSpace], operator: SchurOperator) -> None:
        mesh, launch = operator.mesh, operator.launch
        self._mesh, self._launch = mesh, launch
        starts = np.cumsum([0, *(int(space.numbers.max()) + 1 for space in spaces)])
        smooth, both, one, other = (
            np.where(space.numbers < 0, 0, space.numbers + start)
            for space, start in zip(spaces, starts[:-1], strict=True)
        )
        numbers = np.concatenate([smooth, both, one + other], axis=1, dtype=np.int32)
        values = np.concatenate([space.values for space in spaces[:3]], axis=1)
        count = numbers.shape[1]
        self._kernels = coarse_kernels(mesh.mesh.np, count, mesh.real, mesh.shape)
        launch.load(self._kernels.restrict, self._kernels.prolong)
        self._values = mesh.upload(values.T)
        here = mesh.part.elements
        self._mass = mesh.on_elements(mesh.mesh.quadrature * mesh.mesh.jacobian[here])
        self._numbers = mesh.on_elements(numbers[here], scalar=wp.int32)
        mine = vector(mesh, mesh.groups * count * mesh.lanes)
        self._local = mine.values.reshape((mesh.groups, count))
        few, many = self._kernels.shares
        self._dims = (mesh.groups, count // few), (mesh.groups, mesh.points // many)
        assembly = _assembly(numbers, mesh.collected_order, mesh.lanes)
        self._assembly = SlicedMatrix(mesh, launch, assembly)
        self._integrals = vector(mesh, assembly.shape[1]) if mesh.comm.shared else mine
        self.coefficients = vector(mesh, int(starts[-1]))
        """Of all functions."""

    def restrict(self, b: Field, out: Field) -> None:
        """Integrals of b times each function [m2]."""
        mesh = self._mesh
        kernel, dim = self._kernels.restrict, self._dims[0]
        self._launch(kernel, dim, self._values, self._mass, b.values, self._local)
        if mesh.comm.shared:
            mesh.comm.do(self._join)
        self._assembly(self._integrals, out)

    def _join(self) -> None:
        self._mesh.write(self._mesh.collect_elements(self._local), self._integrals.flat)

    def prolong(self, x: Field) -> None:
        """Add the functions times their coefficients to x."""
        kernel, dim = self._kernels.prolong, self._dims[1]
        self._launch(kernel, dim, self._values, self._numbers, self.coefficients.flat, x.values)


def longest_waves(mesh: Mesh, smooth: scipy.sparse.csr_array) -> scipy.sparse.csr_array:
    """(V, m) values of the nodal functions of a coarse mesh at the vertices of smooth functions.

    smooth: (N, V) their nodal values, 1 at the own vertex.
    """
    per_edge = np.sqrt((smooth.shape[1] - 2) / 6.0)
    ne = max(1, round(per_edge / SPACING))
    coarse = Mesh.build(ne, 3, mesh.radius, mesh.stretch, mesh.centre, mesh.spin)
    at = smooth.tocsc().argmax(axis=0)
    return Interpolator(coarse, mesh.lon[at], mesh.lat[at]).matrix


def _filled(matrix: scipy.sparse.csr_array, shape: tuple[int, int]) -> scipy.sparse.csr_array:
    """The matrix with empty rows and columns behind."""
    wider = scipy.sparse.csr_array(matrix, copy=True)
    wider.resize(shape)
    return wider


def _assembly(
    numbers: NDArray[np.int32], places: NDArray[np.int64], lanes: int
) -> scipy.sparse.csr_array:
    """Sums over the elements (E, k), which stand as (groups, k, lanes) at those places."""
    count = numbers.shape[1]
    element, function = np.indices(numbers.shape).reshape(2, -1)
    group, lane = np.divmod(places[element], lanes)
    columns = (group * count + function) * lanes + lane
    shape = (int(numbers.max()) + 1, -(-len(numbers) // lanes) * count * lanes)
    ones = np.ones(numbers.size, dtype=np.float32)
    return scipy.sparse.csr_array((ones, (numbers.ravel(), columns)), shape=shape)


def _without_small(matrix: scipy.sparse.coo_array) -> scipy.sparse.csr_array:
    """The matrix without entries that are NEGLIGIBLE beside the diagonal."""
    scale = np.sqrt(matrix.diagonal())
    kept = np.abs(matrix.data) > NEGLIGIBLE * scale[matrix.row] * scale[matrix.col]
    entries = matrix.data[kept], (matrix.row[kept], matrix.col[kept])
    return scipy.sparse.csr_array(entries, shape=matrix.shape)
