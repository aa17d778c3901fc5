"""Approximate inverses of the Schur complement S, in the number type of the operator."""

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import numpy as np
import scipy
import warp as wp
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError
from swe_sphere.kernels.patches import patch_kernel
from swe_sphere.operators.damping import Rate
from swe_sphere.operators.field import Field
from swe_sphere.operators.schur import SchurMatrix, SchurOperator
from swe_sphere.solvers.preconditioners.chebyshev import chebyshev_coefficients, spectral_bound
from swe_sphere.solvers.preconditioners.coarse import CoarseCorrection
from swe_sphere.solvers.preconditioners.preconditioner import coarse_memory, unique_nodes

COURANT_A_STEP = 10.0
COURANT_A_CYCLE = 20.0
MOST_CYCLES = 4
"""Gravity-wave Courant numbers (root of the largest diagonal entry of S) from which one more
Chebyshev step, and for each of which one more cycle, pays."""
DEGREES = {3: 3, 4: 2}
"""Chebyshev steps by np, where not 4.  At np 3 all waves share their shortest wave, whose nodal
values are 1, 0, -1, 0: the coarse correction overshoots it, and two steps leave as much of it as
there was, so that the cycle is singular from some mesh on."""
LARGEST_MEMORY = 4e9
"""Memory [bytes] that a factorisation or patch inverses may take."""


def schur_operator(
    model: Model, coriolis: Array, real: Any, outer: Any, damping: Rate | None = None
) -> SchurOperator:
    """S of a model with that Coriolis parameter (N,) [s-1], in one number type inside.

    outer: number type of the states that it eliminates from and substitutes into; damping: of wind
    and depth by wavenumber, if any.
    """
    mesh = model.device_mesh.like(real, model.shape)
    return SchurOperator(mesh, model.launch, model.scene.planet.gravity, coriolis, outer, damping)


class InnerSolver(ABC):
    """Approximate inverse of S; `prepare`, or `setup` with the operator configured, before `solve`.

    Raises ConfigError where it would not fit in memory.
    """

    launches: ClassVar[bool] = False
    """Whether `solve` only launches kernels, so that it can be recorded."""

    def __init__(self, operator: SchurOperator) -> None:
        self.operator = operator
        self.matrix = SchurMatrix(operator.mesh.mesh, operator.gravity, operator.coriolis)

    def prepare(self, tau: float, depth: Array) -> Array:
        """Bring the operator and its inverse to tau [s] and the depth (N,) [m].

        Returns one over the diagonal of S (N,).
        """
        inverse = 1.0 / self.matrix.diagonal(tau, depth)
        self.operator.configure(tau, depth, inverse)
        self.setup(tau, depth)
        return inverse

    @classmethod
    def memory_estimate(cls, ne: int, np: int) -> float:
        """Memory [bytes] that it takes on that mesh; rather too much."""
        return coarse_memory(ne, np)

    @abstractmethod
    def setup(self, tau: float, depth: Array) -> None:
        """Prepare for the implicit step tau [s] and the depth (N,) [m]."""

    @abstractmethod
    def solve(self, b: Field, x: Field) -> None:
        """x near S^-1 b; b may be overwritten."""

    def refuse_if_large(self, memory: float, what: str) -> None:
        """ConfigError where that takes more memory [bytes] than is reasonable."""
        if memory > LARGEST_MEMORY:
            raise ConfigError(
                f"{what} would take about {memory / 1e9:.0f} GB; choose the preconditioner "
                f"helmholtz (multilevel) instead of helmholtz-{type(self).__name__.lower()}"
            )

    def chebyshev(self, degree: int, diagonal: Array) -> list[tuple[float, float, float]]:
        """Coefficients of so many Chebyshev steps on S with that diagonal (N,)."""
        return chebyshev_coefficients(degree, self.largest_eigenvalue(1.0 / diagonal))

    def largest_eigenvalue(self, inverse: Array) -> float:
        """Bound on the spectrum of S, as the operator has it, over its diagonal (N,) inverted."""
        operator = self.operator
        x, image = operator.field(), operator.field()

        def product(values: Array) -> Array:
            operator.put(values, x)
            operator.apply(x, image)
            return inverse * operator.fetch(image)

        return spectral_bound(product, inverse.size)


class Jacobi(InnerSolver):
    """One damped division by the diagonal."""

    def setup(self, tau: float, depth: Array) -> None:
        """Prepare for the implicit step tau [s] and the depth (N,) [m]."""
        self._inverse = 1.0 / self.matrix.diagonal(tau, depth)

    def solve(self, b: Field, x: Field) -> None:
        """x = b / diag S."""
        self.operator.put(self._inverse * self.operator.fetch(b), x)


class Direct(InnerSolver):
    """Sparse LU factors of S, on the host."""

    def __init__(self, operator: SchurOperator) -> None:
        super().__init__(operator)
        n, degree = self.matrix.mesh.size, self.matrix.mesh.np - 1
        factors = f"the factors of a {n} x {n} Schur complement"
        self.refuse_if_large(12.0 * 2.2 * degree * n**1.5, factors)

    @classmethod
    def memory_estimate(cls, ne: int, np: int) -> float:
        """With the factors of the whole matrix."""
        factors: float = 30.0 * (np - 1) * unique_nodes(ne, np) ** 1.5
        return super().memory_estimate(ne, np) + factors

    def setup(self, tau: float, depth: Array) -> None:
        """Factorise for the implicit step tau [s] and the depth (N,) [m]."""
        self._factors = scipy.sparse.linalg.splu(
            self.matrix.matrix(tau, depth).tocsc(), permc_spec="MMD_AT_PLUS_A"
        )

    def solve(self, b: Field, x: Field) -> None:
        """x = S^-1 b."""
        self.operator.put(self._factors.solve(self.operator.fetch(b)), x)


class Multilevel(InnerSolver):
    """Cycles of a coarse correction, of smooth waves and computational modes, and Chebyshev steps.

    At large gravity-wave Courant numbers a Chebyshev step and more cycles are added.  With
    `symmetric`, as many steps go before the correction, as conjugate gradients need.
    """

    launches = True

    def __init__(
        self, operator: SchurOperator, degree: int | None = None, symmetric: bool = False
    ) -> None:
        super().__init__(operator)
        self._degree = degree or DEGREES.get(operator.mesh.mesh.np, 4)
        self._symmetric = symmetric
        self._coarse = CoarseCorrection(self.matrix, operator, symmetric)
        self._direction, self._rest = operator.field(), operator.field()

    def setup(self, tau: float, depth: Array) -> None:
        """Prepare for the implicit step tau [s] and the depth (N,) [m]."""
        diagonal = self.matrix.diagonal(tau, depth)
        courant = float(np.sqrt(diagonal.max()))
        degree = self._degree + (courant > COURANT_A_STEP)
        self._steps = self.chebyshev(degree, diagonal)
        self._coarse.setup(tau, depth)
        self._cycles = min(1 + int(courant / COURANT_A_CYCLE), MOST_CYCLES)

    def solve(self, b: Field, x: Field) -> None:
        """x near S^-1 b; b is overwritten."""
        for cycle in range(self._cycles):
            if cycle > 0 or self._symmetric:
                wp.copy(self._rest.values, b.values)
                self._smooth(self._rest, x, from_zero=cycle == 0)
                self.operator.residual(b, x, self._rest)
                self._coarse.correct(self._rest, x)
            else:
                x.values.zero_()
                self._coarse.correct(b, x)
            if self._symmetric and cycle < self._cycles - 1:
                wp.copy(self._rest.values, b.values)
                self._smooth(self._rest, x)
        self._smooth(b, x)

    def _smooth(self, r: Field, x: Field, from_zero: bool = False) -> None:
        """Chebyshev steps from x or from zero; r, the right-hand side, is overwritten."""
        first, *others = self._steps
        if from_zero:
            self.operator.chebyshev_start(first, r, self._direction, x)
        else:
            wp.copy(self._direction.values, x.values)
            self.operator.chebyshev_step(first, r, self._direction, x)
        for step in others:
            self.operator.chebyshev_step(step, r, self._direction, x)


class Schwarz(InnerSolver):
    """Each element solves on itself and its neighbours and keeps the values of its own nodes.

    The rows of the patch inverses that are kept are computed once, so that a sweep is a product
    with a sparse matrix of fixed row length (Cai & Sarkis 1999, doi:10.1137/S106482759732678X).
    """

    @classmethod
    def memory_estimate(cls, ne: int, np: int) -> float:
        """With the inverses of the patches."""
        return super().memory_estimate(ne, np) + 8.0 * (3 * np - 2) ** 2 * unique_nodes(ne, np)

    def setup(self, tau: float, depth: Array) -> None:
        """Invert the patches for the implicit step tau [s] and the depth (N,) [m].

        Raises ConfigError where the kept rows would not fit in memory.
        """
        mesh = self.matrix.mesh
        longest = (3 * mesh.np - 2) ** 2
        self.refuse_if_large(8.0 * mesh.size * longest, "the patch inverses")
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
        self._b, self._x = (
            wp.zeros(operator.size, dtype=operator.mesh.real, device=operator.mesh.device)
            for _ in range(2)
        )
        operator.launch.load(self._kernel)

    def solve(self, b: Field, x: Field) -> None:
        """x = one sweep for b."""
        operator = self.operator
        operator.collect(b, self._b)
        right = self._b
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
