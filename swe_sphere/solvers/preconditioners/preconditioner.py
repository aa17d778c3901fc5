"""Base of all preconditioners, which reuses set-ups and treats tracers after wind and depth."""

import time
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError
from swe_sphere.operators.tracers import MixingRatio
from swe_sphere.settings.registry import Registry

PRECONDITIONERS: "Registry[Preconditioner]" = Registry("preconditioner")
"""All preconditioners by name; a class with a `name` registers itself."""

COSTS = ("preconditioner_applications", "setups", "setup_seconds")
LARGEST_MEMORY = 4e9
"""Largest memory [bytes] of the factors of a preconditioner."""
STEP_CHANGE = 0.1
DEPTH_CHANGE = 0.1
"""Relative change of tau, or of depth anywhere, above which a new set-up pays off."""


class Preconditioner(ABC):
    """Approximate inverse of I - tau J, J the Jacobian of the right-hand side.

    A subclass implements `setup` and `apply` for wind and depth. Tracers follow these, if `ratio`
    holds their mixing ratios: z_hq = r_hq + q (z_h - r_h). This is block elimination with the
    gravity waves of the depth, because -div(hq V) is q times -div(h V) apart from the gradient of
    q, which is advection and omitted here as it is for the depth. A constant q gives z_hq = q z_h
    for r_hq = q r_h, and so for every Krylov vector: q stays constant to round-off.
    """

    name: ClassVar[str]
    """Name for users; a class without a name is a base of others."""

    counters: dict[str, float] = dict.fromkeys(COSTS, 0)
    """The model's counters once `make_preconditioner` has set them; it adds those of `COSTS`."""
    ratio: MixingRatio | None = None
    """Mixing ratios of the tracers of a state; None without tracers."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "name" in vars(cls):
            PRECONDITIONERS.add(cls)

    @classmethod
    def memory_of_factors(cls, nodes: int, np: int) -> float:
        """Return the approximate memory [bytes] of the factors for `nodes` nodes."""
        return 0.0

    @abstractmethod
    def setup(self, state: wp.array, tau: float) -> None:
        """Prepare for the implicit step tau [s] at a state; inexpensive when little has changed."""

    @abstractmethod
    def apply(self, r: wp.array, out: wp.array) -> None:
        """Set out to about (I - tau J)^-1 r, both states."""

    def update(self, state: wp.array, tau: float) -> None:
        """Prepare for the implicit step tau [s] at a state, tracers included."""
        self.setup(state, tau)
        if self.ratio is not None:
            self.ratio.set(state)

    def __call__(self, r: wp.array, out: wp.array) -> None:
        """Write about (I - tau J)^-1 r to `out`, both states, tracers included."""
        self.counters["preconditioner_applications"] += 1
        self.apply(r, out)
        if self.ratio is not None:
            self.ratio.follow(r, out)

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """Return the inputs from which a restarted run rebuilds the set-up in use."""
        return {}

    def load_state_dict(self, state: Mapping[str, NDArray[Any]]) -> None:  # noqa: B027 (optional)
        """Repeat the set-up in the result of `state_dict`; without one, discard the present one."""


class IdentityPreconditioner(Preconditioner):
    """No preconditioner: `make_preconditioner` returns None for it."""

    name = "none"

    def setup(self, state: wp.array, tau: float) -> None:
        """Do nothing."""

    def apply(self, r: wp.array, out: wp.array) -> None:
        """Set out = r."""
        wp.copy(out, r)


class LaggedPreconditioner(Preconditioner):
    """A preconditioner that is set up again when the step or the flow has changed significantly.

    It depends on the blocks (N,) of wind and depth from number `first` on. Raises ConfigError if
    its factors would exceed `LARGEST_MEMORY`.
    """

    first: ClassVar[int] = 0

    def __init__(self, model: Model) -> None:
        if (memory := self.memory_of_factors(model.mesh.size, model.mesh.np)) > LARGEST_MEMORY:
            raise ConfigError(
                f"the factors of {self.name} would take about {memory / 1e9:.0f} GB; choose the"
                f" preconditioner helmholtz instead of {self.name}"
            )
        self._model = model
        self._tau, self._flow = 0.0, np.zeros(0)

    def setup(self, state: wp.array, tau: float) -> None:
        flow = state[self.first * self._model.device_mesh.size : self._model.fluid_size]
        if abs(tau - self._tau) > STEP_CHANGE * tau or not self._is_near(flow):
            self._make(tau, self._model.device_mesh.collect(flow).astype(np.float64))

    def state_dict(self) -> dict[str, NDArray[Any]]:
        return {"setup_tau": np.array(self._tau), "setup_flow": self._flow.copy()}

    def load_state_dict(self, state: Mapping[str, NDArray[Any]]) -> None:
        tau, flow = float(state.get("setup_tau", 0.0)), np.array(state.get("setup_flow", ()))
        blocks = self._model.fluid_size // self._model.device_mesh.size - self.first
        self._tau = 0.0
        if tau > 0.0 and flow.size == blocks * self._model.mesh.size:  # not of another class
            self._make(tau, flow)

    def _make(self, tau: float, flow: Array) -> None:
        start = time.perf_counter()
        self._tau, self._flow = tau, flow
        self._prepare(tau, flow)
        self.counters["setups"] += 1
        self.counters["setup_seconds"] += time.perf_counter() - start

    @abstractmethod
    def _is_near(self, flow: wp.array) -> bool:
        """Return whether these blocks have changed little, on all ranks."""

    @abstractmethod
    def _prepare(self, tau: float, flow: Array) -> None:
        """Set up for tau [s] and these blocks of the whole mesh."""
