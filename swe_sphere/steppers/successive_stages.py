"""What methods share whose implicit stages are solved one after the other."""

from abc import abstractmethod
from typing import ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.model import Model
from swe_sphere.steppers.implicit import ImplicitStepper
from swe_sphere.steppers.stability import error_constant


class SuccessiveStages(ImplicitStepper):
    """x_new = x + dt sum_i w_i K_i; the guess for each slope K_i is that of one step before."""

    b: ClassVar[tuple[float, ...]]
    embedded: ClassVar[tuple[float, ...] | None] = None
    """Weights of an embedded method of another order, where there is one."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "name" in vars(cls):
            cls.vectors = 19 + 2 * len(cls.b)  # slopes of two steps, and those of the solver
            cls.error_constant = error_constant(cls.matrix(), np.array(cls.b), cls.order)

    @classmethod
    @abstractmethod
    def matrix(cls) -> NDArray[np.float64]:
        """A (stages, stages) of the tableau."""

    def _allocate(self, model: Model) -> None:
        stages = len(self.b)
        self._stack, self._past = self.space.stack(stages), self.space.stack(stages)
        self._slopes = [self._stack[i] for i in range(stages)]
        self._guesses = [self._past[i] for i in range(stages)]
        self._rhs, self._attempted = model.zeros(), 0.0

    def _begin(self, slope: wp.array) -> None:
        for guess in self._guesses:
            self.space.copy(slope, guess)

    def _remembered(self) -> dict[str, wp.array]:
        return {"state": self.state, "slopes": self._past}

    def _weights(self, b: tuple[float, ...]) -> NDArray[np.float64]:
        """w of the slopes for the weights b of the tableau."""
        return np.array(b)

    def _finish(self, dt: float, out: wp.array) -> None:
        """The state at the end of a step of dt [s] all of whose slopes are known."""
        self._attempted = dt
        self.space.combine(self.state, self._stack, dt * self._weights(self.b), out)

    def error_estimate(self) -> float:
        """Norm [m s-1] of the difference to the embedded method, for the step last attempted."""
        assert self.embedded is not None
        difference = self._attempted * (self._weights(self.b) - self._weights(self.embedded))
        self.space.clear(self._rhs)
        self.space.combine(self._rhs, self._stack, difference, self._rhs)
        return self.space.norm(self._rhs)

    def accept(self, dt: float) -> None:
        """Make `new` the present state, and keep the slopes for the guesses of the next step."""
        super().accept(dt)
        self.space.copy(self._stack, self._past)
