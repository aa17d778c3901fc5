"""Steppers that solve equations: how exactly, in which norm, and in parts where that fails."""

from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.model import Model
from swe_sphere.equations.tracer_equations import MassFlux, mixing_ratios
from swe_sphere.errors import ConfigError, SolverFailed
from swe_sphere.ranks.blas import one_thread
from swe_sphere.solvers.vector_space import VectorSpace
from swe_sphere.steppers.motion import Motion
from swe_sphere.steppers.stepper import Stepper

TRACER_SHARE = 0.1
"""About the Froude number of the flows here: with it the change of a tracer that the wind carries
along weighs as much as the change of the wind, and does not drown it."""
NOTHING = 1e-60
"""Weights have to be positive."""


def energy_weights(model: Model) -> NDArray[np.float64]:
    """Weights (n,) of the energy inner product: area, times g/H for depth, over the whole area.

    With them a norm is in [m s-1], and tolerances mean the same in any units and on any planet.
    The mass hq of a tracer counts as depth does, over the largest q of the start, and under a wind
    that is stepped by `TRACER_SHARE` of that; the mass that has crossed a point not at all.
    """
    share: NDArray[np.float64] = model.mesh.area / model.mesh.area.sum()
    ratios = mixing_ratios(model.scene, model.mesh).values()
    largest = [float(np.abs(q).max()) or 1.0 for q in ratios]
    if model.scene.wind is not None:
        return np.concatenate([share, *(share / q**2 for q in largest)])
    _, _, depth = model.scene.initial(model.mesh.lon, model.mesh.lat)
    heights = share * model.scene.planet.gravity / float(np.average(depth, weights=share))
    if isinstance(model.carried, MassFlux):
        return np.concatenate([share, share, heights, NOTHING * share, NOTHING * share])
    tracers = (heights * (TRACER_SHARE / q) ** 2 for q in largest)
    return np.concatenate([share, share, heights, *tracers])


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
        weights, mesh = energy_weights(model), model.device_mesh
        self.space = VectorSpace(weights, mesh=mesh)
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


SMALLEST_PART = 64
"""A step that cannot be solved is halved, and halved again, down to this part of it."""


class SteppedInParts(SolvingStepper):
    """A stepper that attempts steps of any length, and goes on from those that are accepted."""

    def __init__(self, model: Model, dt: float, tolerance: float | None = None) -> None:
        super().__init__(model, dt, tolerance)
        self.tolerance = self.loosest
        """That of the step last attempted."""
        self.counters = {"rejected_steps": 0}
        self.new: wp.array = model.zeros()
        waves = model.scene.effect("pressure-gradient") is not None
        self._needs_depth = waves and not model.scene.linear

    @classmethod
    def stable_dt(cls, wave: float, dissipation: float = 0.0) -> float:
        """Infinite: the step is limited by accuracy alone."""
        return np.inf

    @abstractmethod
    def attempt(self, t: float, dt: float) -> str | None:
        """Write the state one step dt [s] after `state`, at t [s], to `new`.

        Returns what is wrong with it, in words; nothing else has changed before `accept`.
        """

    def accept(self, dt: float) -> None:
        """Make `new`, a step of dt [s] on, the present state, and remember how fast it moved."""
        self.motion.accept(self.state, self.new, dt)
        self.space.copy(self.new, self.state)

    def _advance(self) -> None:
        """One step, or as many equal parts as the solver needs."""
        done, parts, start = 0, 1, self.state
        while done < parts:
            dt = self.dt / parts
            fault = self.attempt(self.time + done * dt, dt)
            if fault is None:
                self.accept(dt)
                done += 1
            else:
                start = wp.clone(self.state) if parts == 1 else start
                self.counters["rejected_steps"] += 1
                done, parts = 2 * done, 2 * parts
                self._give_up_below(parts, fault, start)

    def _give_up_below(self, parts: int, fault: str, start: wp.array) -> None:
        if parts > SMALLEST_PART:
            self.space.copy(start, self.state)  # that of `time`
            raise SolverFailed(
                f"{self.name}: the step from {self.time:.0f} s cannot be solved even in "
                f"{parts // 2} parts: {fault}; choose a smaller --dt"
            )

    def _fault(self) -> str | None:
        """What is wrong with the new state: gravity waves need a positive depth."""
        if not self._needs_depth:
            return None
        end = self.model.fluid_size
        lowest = self.space.lowest(self.new, end - self.model.device_mesh.size, end)
        return None if lowest > 0.0 else f"the depth falls to {lowest:.3g} m"
