"""Steps that are attempted first, and taken in parts where that fails."""

from abc import abstractmethod

import warp as wp

from swe_sphere.equations.model import Model
from swe_sphere.errors import SolverFailed
from swe_sphere.steppers.solving import SolvingStepper

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
        done, parts = 0, 1
        while done < parts:
            dt = self.dt / parts
            fault = self.attempt(self.time + done * dt, dt)
            if fault is None:
                self.accept(dt)
                done += 1
            else:
                self.counters["rejected_steps"] += 1
                done, parts = 2 * done, 2 * parts
                self._give_up_below(parts, fault)

    def _give_up_below(self, parts: int, fault: str) -> None:
        if parts > SMALLEST_PART:
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
