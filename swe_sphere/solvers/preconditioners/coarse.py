"""Coarse correction on the element vertices: one solve for each family of waves, added up."""

from __future__ import annotations

import numpy as np
import scipy
import warp as wp
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.kernels.coarse import coarse_kernels
from swe_sphere.operators import sparse
from swe_sphere.operators.field import Field
from swe_sphere.operators.schur import SchurOperator
from swe_sphere.operators.sparse import ElementSpace
from swe_sphere.solvers.preconditioners.chebyshev import chebyshev_coefficients, spectral_bound
from swe_sphere.solvers.preconditioners.computational_modes import coarse_spaces, interpolation
from swe_sphere.solvers.preconditioners.schur_matrix import SchurMatrix

Float32 = NDArray[np.float32]

MODE_SWEEPS = 6
"""Chebyshev steps on the computational modes, whose coarse operators are well conditioned.  Days
into a run these modes limit the convergence: with three steps it takes half as many iterations
again."""
NEGLIGIBLE = 0.03
"""Couplings of computational modes that are left out, relative to the diagonal."""


class CoarseCorrection:
    """x += sum over the spaces of P_k S_k^-1 P_k^T M b, the inverses on the host in float32.

    The smooth waves have the compact Helmholtz operator, factorised; the computational modes have
    the Galerkin operators of S, and a few Chebyshev steps will do.
    """

    def __init__(self, schur: SchurMatrix, operator: SchurOperator) -> None:
        mesh, spaces, self._schur = schur.mesh, coarse_spaces(schur.mesh), schur
        self._hats = spaces[0]
        self._transfer = Transfer(spaces, operator)
        area = scipy.sparse.diags_array(mesh.area)
        bases = (interpolation(mesh, space) for space in spaces)
        self._mass, *masses = [(basis.T @ (area @ basis)).tocsr() for basis in bases]
        slopes = [sparse.slopes(mesh, space).astype(np.float32) for space in spaces[1:]]
        self._modes = list(zip(masses, slopes, strict=True))
        self._solve = operator.launch.work.counted(f"coarse solve {operator.size}", self._invert)

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

    def correct(self, b: Field, x: Field) -> None:
        """Add the correction for the residual b to x."""
        self._transfer.prolong(self._solve(self._transfer.restrict(b)), x)

    def _invert(self, local: Float32) -> Float32:
        """Coefficients of the functions for what each element has of the residual."""
        coarse: Float32 = self._transfer.assembly @ local
        split = self._mass.shape[0]
        coarse[:split] = self._direct.solve(coarse[:split])
        coarse[split:] = self._sweep(coarse[split:])
        return coarse

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


class Transfer:
    """Between fields and coefficients of all functions of the spaces, one after the other."""

    def __init__(self, spaces: list[ElementSpace], operator: SchurOperator) -> None:
        mesh, self._operator = operator.mesh, operator
        starts = np.cumsum([0, *(int(space.numbers.max()) + 1 for space in spaces)])
        smooth, both, one, other = (
            np.where(space.numbers < 0, 0, space.numbers + start)
            for space, start in zip(spaces, starts[:-1], strict=True)
        )
        numbers = np.concatenate([smooth, both, one + other], axis=1, dtype=np.int32)
        values = np.concatenate([space.values for space in spaces[:3]], axis=1)
        count = numbers.shape[1]
        self._kernels = coarse_kernels(mesh.mesh.np, count, mesh.real, mesh.shape)
        operator.launch.load(self._kernels.restrict, self._kernels.prolong)
        self._values = mesh.upload(values.T)
        here = mesh.part.elements
        self._mass = mesh.on_elements(mesh.mesh.quadrature * mesh.mesh.jacobian[here])
        self._numbers = mesh.on_elements(numbers[here], scalar=wp.int32)
        self._local = wp.zeros((mesh.groups, count), dtype=self._mass.dtype, device=mesh.device)
        self._coefficients = mesh.upload(np.zeros(starts[-1]))
        few, many = self._kernels.shares
        self._dims = (mesh.groups, count // few), (mesh.groups, mesh.points // many)
        self.assembly = _assembly(numbers, mesh.collected_order, mesh.lanes)
        """Sparse matrix from what `restrict` returns to integrals over all elements."""

    def restrict(self, b: Field) -> Float32:
        """Integrals of b times each function over each element of all ranks [m2]."""
        operator, kernel = self._operator, self._kernels.restrict
        operator.launch(kernel, self._dims[0], self._values, self._mass, b.values, self._local)
        integrals: Float32 = operator.mesh.collect_elements(self._local)
        return integrals

    def prolong(self, coefficients: Float32, x: Field) -> None:
        """Add the functions times their coefficients to x."""
        operator, target = self._operator, self._coefficients
        operator.mesh.write(coefficients, target)
        kernel = self._kernels.prolong
        operator.launch(kernel, self._dims[1], self._values, self._numbers, target, x.values)


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
