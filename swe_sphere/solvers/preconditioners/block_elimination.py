"""Preconditioning by block elimination with the consistent Helmholtz operator."""

from functools import partial
from typing import Any, ClassVar

import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError
from swe_sphere.kernels.vectors import nearness_kernel
from swe_sphere.operators.replay import recorded
from swe_sphere.solvers.preconditioners.inner import (
    Direct,
    InnerSolver,
    Jacobi,
    Multilevel,
    Schwarz,
    schur_operator,
)
from swe_sphere.solvers.preconditioners.preconditioner import (
    DEPTH_CHANGE,
    KeptSetup,
    elimination_memory,
)
from swe_sphere.solvers.vector_space import VectorSpace


class BlockElimination(KeptSetup):
    """(I - tau L)^-1 with gravity waves about the current depth, advection left out.

    See `SchurOperator`; a subclass says by what S is inverted, about.
    """

    inner_solver: ClassVar[type[InnerSolver]]
    real: ClassVar[Any] = wp.float32
    """Number type of all vectors inside: a preconditioner needs no more."""

    def __init__(self, model: Model) -> None:
        if model.scene.wind is not None:
            raise ConfigError("a scene with prescribed wind has no gravity waves to precondition")
        super().__init__(model)
        outer = model.device_mesh.real
        damping = model.damping if model.diffusive else None
        self.operator = schur_operator(model, model.coriolis, self.real, outer, damping)
        self.inner = self.inner_solver(self.operator)
        self._b, self._h = self.operator.field(), self.operator.field()
        mesh, nearness = model.device_mesh, nearness_kernel(outer)
        self._space = VectorSpace(mesh.mesh.area, mesh=mesh)
        self._then, self._nearness = self._space.zeros(), self._space.zeros()
        model.launch.load(nearness)
        self._compare = partial(model.launch, nearness, mesh.size, DEPTH_CHANGE)

    @classmethod
    def memory_estimate(cls, ne: int, np: int) -> float:
        """Memory [bytes] that it takes on that mesh, about."""
        return elimination_memory(ne, np) + cls.inner_solver.memory_estimate(ne, np)

    def _needed(self, fluid: Array) -> Array:
        return fluid[2 * fluid.size // 3 :]

    def _is_near(self, fluid: wp.array) -> bool:
        n = self._space.n
        self._compare(fluid, 2 * n, self._then, self._nearness)
        return self._space.lowest(self._nearness, 0, n) >= 0.0

    def _prepare(self, tau: float, flow: Array) -> None:
        self._space.load(flow, self._then)
        self.inner.prepare(tau, flow)
        launch, apply = self.operator.launch, self._apply
        self._act = recorded(launch, apply) if self.inner.launches else apply

    def apply(self, r: wp.array, out: wp.array) -> None:
        """out near (I - tau J)^-1 r, both (3N,)."""
        self._act(r, out)

    def _apply(self, r: wp.array, out: wp.array) -> None:
        self.operator.eliminate(r, self._b)
        self.inner.solve(self._b, self._h)
        self.operator.substitute(r, self._h, out)


class JacobiElimination(BlockElimination):
    """The Schur complement by its diagonal."""

    name, inner_solver = "jacobi", Jacobi


class Helmholtz(BlockElimination):
    """The Schur complement by a coarse correction and Chebyshev steps."""

    name, inner_solver = "helmholtz", Multilevel


class SchwarzElimination(BlockElimination):
    """The Schur complement by overlapping patches."""

    name, inner_solver = "helmholtz-schwarz", Schwarz


class DirectElimination(BlockElimination):
    """The Schur complement by sparse factors."""

    name, inner_solver, real = "helmholtz-direct", Direct, wp.float64
