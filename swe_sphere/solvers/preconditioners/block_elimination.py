"""Preconditioning by block elimination with the consistent Helmholtz operator."""

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError
from swe_sphere.operators import DeviceMesh
from swe_sphere.operators.schur import SchurOperator
from swe_sphere.solvers.preconditioners.inner import InnerSolver
from swe_sphere.solvers.preconditioners.schur_matrix import SchurMatrix

Array = NDArray[np.float64]

STEP_CHANGE = 0.1
DEPTH_CHANGE = 0.1
"""Relative changes of tau and of depth anywhere from which a new set-up pays."""


class Helmholtz:
    """(I - tau L)^-1 with gravity waves about the current depth, advection left out.

    See `SchurOperator`; `inner` makes the approximate inverse of S.  All vectors inside have the
    number type `real`, float32 by default: a preconditioner needs no more.
    """

    def __init__(
        self,
        model: Model,
        inner: Callable[[SchurOperator, SchurMatrix], InnerSolver],
        real: Any = wp.float32,
    ) -> None:
        if model.scene.wind is not None:
            raise ConfigError("a scene with prescribed wind has no gravity waves to precondition")
        self._model = model
        mesh = DeviceMesh(model.mesh, model.device, real, model.shape)
        gravity, outer = model.scene.planet.gravity, model.device_mesh.real
        self.operator = SchurOperator(mesh, model.launch, gravity, model.coriolis, outer)
        self.matrix = SchurMatrix(model.mesh, gravity, model.coriolis)
        self.inner = inner(self.operator, self.matrix)
        self._b, self._h = self.operator.vector(), self.operator.vector()
        self._tau, self._depth = 0.0, np.zeros(model.mesh.size)
        self.setup_seconds, self.setups, self.applications = 0.0, 0, 0

    def setup(self, state: wp.array, tau: float) -> None:
        """Prepare for the implicit step tau [s] at a state; nothing to do if little has changed."""
        n = self._model.mesh.size
        depth = state.numpy()[2 * n : 3 * n].astype(np.float64)
        if abs(tau - self._tau) <= STEP_CHANGE * tau and self._is_near(depth):
            return
        self._make(tau, depth)

    def memory(self) -> dict[str, NDArray[Any]]:
        """Step and depth that the set-up in use was made for."""
        return {"setup_tau": np.array(self._tau), "setup_depth": self._depth.copy()}

    def restore(self, memory: Mapping[str, NDArray[Any]]) -> None:
        """Make that set-up again; where there was none, forget the present one."""
        self._tau = float(memory.get("setup_tau", np.zeros(())))
        if self._tau > 0.0:
            self._make(self._tau, np.array(memory["setup_depth"]))

    def _make(self, tau: float, depth: Array) -> None:
        start = time.perf_counter()
        self._tau, self._depth = tau, depth
        self.operator.configure(tau, depth, 1.0 / self.matrix.diagonal(tau, depth))
        self.inner.setup(tau, depth)
        self.setups += 1
        self.setup_seconds += time.perf_counter() - start

    def apply(self, r: wp.array, out: wp.array) -> None:
        """out near (I - tau J)^-1 r, both (3N,)."""
        self.applications += 1
        self.operator.eliminate(r, self._b)
        self.inner.solve(self._b, self._h)
        self.operator.substitute(r, self._h, out)

    def _is_near(self, depth: Array) -> bool:
        return bool(np.all(np.abs(depth - self._depth) <= DEPTH_CHANGE * np.abs(depth)))
