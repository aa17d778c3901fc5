"""Preconditioners whose set-up is kept from step to step."""

import time
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.equations.model import Model
from swe_sphere.solvers.preconditioners.preconditioner import Preconditioner

STEP_CHANGE = 0.1
DEPTH_CHANGE = 0.1
"""Relative changes of tau and of depth anywhere from which a new set-up pays."""


class KeptSetup(Preconditioner):
    """One that is set up anew when the step or the flow has changed by much."""

    def __init__(self, model: Model) -> None:
        self._model = model
        self._tau, self._flow, self._here = 0.0, np.zeros(0), np.zeros(0)
        self._set_up = model.launch.work.section("preconditioner set-up", self._make)

    def setup(self, state: wp.array, tau: float) -> None:
        """Prepare for the implicit step tau [s] at a state; nothing to do if little has changed."""
        mesh, fluid = self._model.device_mesh, state[: self._model.fluid_size]
        changed = abs(tau - self._tau) > STEP_CHANGE * tau
        if changed or not mesh.comm.of_each(self._is_near(self._needed(fluid.numpy()))).all():
            self._set_up(tau, self._needed(mesh.collect(fluid)).astype(np.float64))

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """Step and flow that the set-up in use was made for."""
        return {"setup_tau": np.array(self._tau), "setup_flow": self._flow.copy()}

    def load_state_dict(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Make that set-up again; where there was none, forget the present one."""
        self._tau = float(state.get("setup_tau", np.zeros(())))
        if self._tau > 0.0:
            self._make(self._tau, np.array(state["setup_flow"]))

    def _make(self, tau: float, flow: Array) -> None:
        start = time.perf_counter()
        self._tau, self._flow = tau, flow
        self._here = self._model.device_mesh.restrict(flow)
        self._prepare(tau, flow)
        self.setups += 1
        self.setup_seconds += time.perf_counter() - start

    @abstractmethod
    def _needed(self, fluid: Array) -> Array:
        """The fields among wind and depth (3N,) that a set-up hangs on, of any part of the mesh."""

    @abstractmethod
    def _is_near(self, now: Array) -> bool:
        """Whether those of this rank are still much as they were, `_here`."""

    @abstractmethod
    def _prepare(self, tau: float, flow: Array) -> None:
        """Set up for tau [s] and those fields of the whole mesh."""

    def _is_near_in_depth(self, now: Array, then: Array) -> bool:
        return bool(np.all(np.abs(now - then) <= DEPTH_CHANGE * np.abs(now)))
