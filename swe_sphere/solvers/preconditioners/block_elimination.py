"""Preconditioning by block elimination with the consistent Helmholtz operator."""

import time
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError
from swe_sphere.solvers.preconditioners.inner import (
    Direct,
    InnerSolver,
    Jacobi,
    Multilevel,
    schur_operator,
)
from swe_sphere.solvers.preconditioners.preconditioner import Preconditioner, elimination_memory
from swe_sphere.solvers.preconditioners.schwarz import Schwarz

STEP_CHANGE = 0.1
DEPTH_CHANGE = 0.1
"""Relative changes of tau and of depth anywhere from which a new set-up pays."""


class BlockElimination(Preconditioner):
    """(I - tau L)^-1 with gravity waves about the current depth, advection left out.

    See `SchurOperator`; a subclass says by what S is inverted, about.
    """

    inner_solver: ClassVar[type[InnerSolver]]
    real: ClassVar[Any] = wp.float32
    """Number type of all vectors inside: a preconditioner needs no more."""

    def __init__(self, model: Model) -> None:
        if model.scene.wind is not None:
            raise ConfigError("a scene with prescribed wind has no gravity waves to precondition")
        self._model = model
        outer = model.device_mesh.real
        self.operator = schur_operator(model, model.coriolis, self.real, outer)
        self.inner = self.inner_solver(self.operator)
        self._b, self._h = self.operator.vector(), self.operator.vector()
        self._tau, self._depth = 0.0, np.zeros(model.mesh.size)
        self._set_up = model.launch.work.section("preconditioner set-up", self._make)

    @classmethod
    def memory_estimate(cls, ne: int, np: int) -> float:
        """Memory [bytes] that it takes on that mesh, about."""
        return elimination_memory(ne, np) + cls.inner_solver.memory_estimate(ne, np)

    def setup(self, state: wp.array, tau: float) -> None:
        """Prepare for the implicit step tau [s] at a state; nothing to do if little has changed."""
        mesh = self._model.device_mesh
        n = mesh.size
        depth = mesh.collect(state[2 * n : 3 * n]).astype(np.float64)
        if abs(tau - self._tau) <= STEP_CHANGE * tau and self._is_near(depth):
            return
        self._set_up(tau, depth)

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """Step and depth that the set-up in use was made for."""
        return {"setup_tau": np.array(self._tau), "setup_depth": self._depth.copy()}

    def load_state_dict(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Make that set-up again; where there was none, forget the present one."""
        self._tau = float(state.get("setup_tau", np.zeros(())))
        if self._tau > 0.0:
            self._make(self._tau, np.array(state["setup_depth"]))

    def _make(self, tau: float, depth: Array) -> None:
        start = time.perf_counter()
        self._tau, self._depth = tau, depth
        self.inner.prepare(tau, depth)
        self.setups += 1
        self.setup_seconds += time.perf_counter() - start

    def apply(self, r: wp.array, out: wp.array) -> None:
        """out near (I - tau J)^-1 r, both (3N,)."""
        self.operator.eliminate(r, self._b)
        self.inner.solve(self._b, self._h)
        self.operator.substitute(r, self._h, out)

    def _is_near(self, depth: Array) -> bool:
        return bool(np.all(np.abs(depth - self._depth) <= DEPTH_CHANGE * np.abs(depth)))


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
