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
        self._tau, self._flow = 0.0, np.zeros(0)
        self._set_up = model.launch.work.section("preconditioner set-up", self._make)

    def setup(self, state: wp.array, tau: float) -> None:
        """Prepare for the implicit step tau [s] at a state; nothing to do if little has changed."""
        model = self._model
        fluid = model.device_mesh.collect(state[: model.fluid_size])
        flow = self._needed(fluid).astype(np.float64)
        if abs(tau - self._tau) > STEP_CHANGE * tau or not self._is_near(flow):
            self._set_up(tau, flow)

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
        self._prepare(tau, flow)
        self.setups += 1
        self.setup_seconds += time.perf_counter() - start

    @abstractmethod
    def _needed(self, fluid: Array) -> Array:
        """The part of wind and depth (3N,) of the whole mesh that a set-up hangs on."""

    @abstractmethod
    def _is_near(self, flow: Array) -> bool:
        """Whether that part is still much as it was."""

    @abstractmethod
    def _prepare(self, tau: float, flow: Array) -> None:
        """Set up for tau [s] and that part."""

    def _is_near_in_depth(self, now: Array, then: Array) -> bool:
        return bool(np.all(np.abs(now - then) <= DEPTH_CHANGE * np.abs(now)))
