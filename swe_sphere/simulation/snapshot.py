"""The state between two steps, as those who watch a run see it."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from swe_sphere.equations.model import Model
    from swe_sphere.steppers import Stepper

__all__ = ["Moment", "Observer"]

Array = NDArray[np.float64]


class Moment:
    """A time of the run with its fields, fetched from the device when first asked for."""

    def __init__(self, model: Model, stepper: Stepper, time: float) -> None:
        self._model, self._stepper = model, stepper
        self.time = time
        """[s] since the start."""
        self.step = stepper.steps
        """Steps since the start."""

    @cached_property
    def fields(self) -> dict[str, Array]:
        """u, v [m s-1] and h [m], each (N,)."""
        return self._model.fields(self._stepper.state, self._stepper.time)

    @cached_property
    def all_fields(self) -> dict[str, Array]:
        """The fields with vorticity and divergence [s-1], each (N,)."""
        state, time = self._stepper.state, self._stepper.time
        return self.fields | {
            "vorticity": self._model.vorticity(state, time),
            "divergence": self._model.divergence(state, time),
        }

    def memory(self) -> dict[str, NDArray[np.generic]]:
        """All arrays of the stepper."""
        return self._stepper.state_dict()


class Observer(Protocol):
    """Something that looks at the state now and then; RunFailed from it ends the run."""

    def due(self, step: int) -> bool:
        """Whether it wants to see the state after that many steps."""

    def observe(self, moment: Moment) -> None:
        """Look at the state."""
