"""What all steppers share that solve equations: how exactly they do, and what that is tied to."""

from typing import Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError
from swe_sphere.solvers.vector_space import VectorSpace
from swe_sphere.steppers.energy_norm import energy_weights
from swe_sphere.steppers.motion import Motion
from swe_sphere.steppers.stepper import Stepper
from swe_sphere.steppers.threads import one_thread


class SolvingStepper(Stepper):
    """A stepper whose solves leave less than the estimated truncation error of its steps.

    `tolerance`: largest residual, relative to the change over a step; solved for is a part of the
    truncation error, where that is smaller (see `Motion`).  Raises ConfigError for one out of
    range.
    """

    error_constant: ClassVar[float]
    """C in the truncation error C dt^(order + 1) d^(order + 1)x/dt^(order + 1) of a step."""
    default_tolerance: ClassVar[float] = 1e-3
    """For steps that do not resolve the motion: where the error of the solver is well below that of
    the scheme (docs/steppers.md)."""

    def __init__(self, model: Model, dt: float, tolerance: float | None = None) -> None:
        super().__init__(model, dt)
        tolerance = self.default_tolerance if tolerance is None else tolerance
        if not 0.0 <= tolerance < 1.0:
            raise ConfigError(f"the solver tolerance must be in [0, 1), not {tolerance}")
        self.loosest = tolerance
        """Largest residual that a solve may leave, relative to the change over a step."""
        self.space = VectorSpace(
            energy_weights(model),
            model.device,
            model.device_mesh.real,
            work=model.launch.work,
            mesh=model.device_mesh,
        )
        self.motion = Motion(self.space)

    def _allocate(self, model: Model) -> None:
        """Make the work vectors of the scheme; the solver and its space are there."""

    def start(self, state: wp.array, t: float = 0.0) -> None:
        """Begin from a copy of the state at time t [s]."""
        super().start(state, t)
        self._begin(self.motion.start(self.model, self.state, t, self.dt))

    def _begin(self, slope: wp.array) -> None:
        """Make the first guesses from the slope at the start."""

    def step(self) -> None:
        """Move `state` forward by dt."""
        with one_thread():
            super().step()

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """Copies of all that a bitwise exact restart needs."""
        return super().state_dict() | self.motion.state_dict()

    def load_state_dict(self, state: dict[str, NDArray[np.generic]], steps: int) -> None:
        """Go on from what `state_dict` returned after that many steps."""
        super().load_state_dict(state, steps)
        self.motion.load_state_dict(state)

    def _goal(self, dt: float) -> float:
        """Residual to solve a step of dt [s] to, relative to the change over it."""
        return min(self.loosest, self.motion.truncation(self.error_constant, self.order, dt))
