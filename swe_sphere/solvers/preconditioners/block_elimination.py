"""Preconditioning by block elimination with the consistent Helmholtz operator."""

import math
from abc import abstractmethod
from functools import partial
from typing import Any, ClassVar

import scipy
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.equations.effects import Effect
from swe_sphere.equations.model import Model
from swe_sphere.kernels.vectors import nearness
from swe_sphere.operators.device_mesh import Field
from swe_sphere.operators.replay import Replay
from swe_sphere.solvers.preconditioners.multilevel import Multilevel, schur_operator
from swe_sphere.solvers.preconditioners.preconditioner import DEPTH_CHANGE, LaggedPreconditioner
from swe_sphere.solvers.vector_space import VectorSpace


class BlockElimination(LaggedPreconditioner):
    """(I - tau L)^-1 with gravity waves about the current depth, without advection.

    It eliminates the wind, see `SchurOperator`; a subclass inverts the Schur complement S
    approximately, by `invert` and `solve`, with S as `operator` on the device and, without the
    damping F, as `operator.matrix` on the host.
    """

    real: ClassVar[Any] = wp.float32
    """Number type of all internal vectors: a preconditioner needs no more."""
    launches: ClassVar[bool] = False
    """True if `solve` only launches kernels, so that it can be recorded."""

    first = 2

    def __init__(self, model: Model) -> None:
        super().__init__(model)
        outer = model.device_mesh.real
        damps = any(type(e).damping is not Effect.damping for e in model.scene.effects)
        damping = model.damping if damps else None
        self.operator = schur_operator(model, model.coriolis, self.real, outer, damping)
        self._b, self._h = self.operator.field(), self.operator.field()
        mesh, (compare,) = model.device_mesh, model.launch.compile(outer, nearness)
        self._space = VectorSpace(mesh.mesh.area, mesh=mesh)
        self._then, self._nearness = self._space.zeros(), self._space.zeros()
        self._compare = partial(model.launch, compare, mesh.size, DEPTH_CHANGE)

    @abstractmethod
    def invert(self, tau: float, depth: Array) -> None:
        """Prepare `solve` for the implicit step tau [s] and the depth (N,) [m]."""

    @abstractmethod
    def solve(self, b: Field, x: Field) -> None:
        """Write an approximation of S^-1 b to x; b may be overwritten."""

    def _is_near(self, flow: wp.array) -> bool:
        self._compare(flow, 0, self._then, self._nearness)
        return self._space.lowest(self._nearness, 0, self._space.n) >= 0.0

    def _prepare(self, tau: float, flow: Array) -> None:
        self._then.assign(self.operator.mesh.on_rank(flow))
        self.operator.configure(tau, flow)
        self.invert(tau, flow)
        self._replay = Replay(self.operator.mesh.launch)

    def apply(self, r: wp.array, out: wp.array) -> None:
        if not self.launches:
            self._eliminate(r, out)
        elif not self._replay.launch(key := (r.ptr, out.ptr)):
            with self._replay.record(key):
                self._eliminate(r, out)

    def _eliminate(self, r: wp.array, out: wp.array) -> None:
        self.operator.eliminate(r, self._b)
        self.solve(self._b, self._h)
        self.operator.substitute(r, self._h, out)


class Helmholtz(BlockElimination):
    """Block elimination that inverts S by a coarse correction and Chebyshev steps."""

    name, launches = "helmholtz", True

    def __init__(self, model: Model) -> None:
        super().__init__(model)
        self._multilevel = Multilevel(self.operator)

    def invert(self, tau: float, depth: Array) -> None:
        self._multilevel.setup(tau, depth)

    def solve(self, b: Field, x: Field) -> None:
        self._multilevel.solve(b, x)


class DirectElimination(BlockElimination):
    """Block elimination that inverts S by sparse LU factors, on the host."""

    name, real = "helmholtz-direct", wp.float64

    @classmethod
    def memory_of_factors(cls, nodes: int, np: int) -> float:
        return 12.0 * 2.2 * (np - 1) * nodes * math.sqrt(nodes)

    def invert(self, tau: float, depth: Array) -> None:
        matrix = self.operator.matrix.matrix(tau, depth).tocsc()
        self._factors = scipy.sparse.linalg.splu(matrix, permc_spec="MMD_AT_PLUS_A")

    def solve(self, b: Field, x: Field) -> None:
        self.operator.put(self._factors.solve(self.operator.fetch(b)), x)
