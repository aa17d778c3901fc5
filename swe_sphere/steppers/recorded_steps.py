"""Steps that are recorded and repeated, and a check that those of a custom stepper may be."""

from collections.abc import Hashable
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from swe_sphere.errors import ConfigError
from swe_sphere.operators.replay import Replay

if TYPE_CHECKING:
    from swe_sphere.steppers.stepper import Stepper


class CheckedReplay(Replay):
    """A replay whose first repetition of a step is compared with the step itself, bit for bit.

    Work that a step does on the host, and numbers that change from step to step, are not recorded.
    Raises ConfigError where the repetition differs.
    """

    def __init__(self, stepper: "Stepper") -> None:
        super().__init__(stepper.model.launch, stepper.model.counters)
        self._stepper = stepper
        self._checked: set[Hashable] = set()

    def __call__(self, key: Hashable) -> bool:
        """Launch the recording of a step; return False where the step has to be run."""
        if key in self._checked:
            return super().__call__(key)
        arrays, counted = self._stepper.arrays(), dict(self._counters)
        before = [wp.clone(array) for array in arrays.values()]
        if not super().__call__(key):
            return False
        self._checked.add(key)
        repeated = [array.numpy().copy() for array in arrays.values()]
        self._counters.update(counted)
        for array, values in zip(arrays.values(), before, strict=True):
            wp.copy(array, values)
        self._stepper.advance()
        for (name, array), values in zip(arrays.items(), repeated, strict=True):
            if not np.array_equal(array.numpy(), values, equal_nan=True):
                raise ConfigError(
                    f"stepper {self._stepper.name}: a recorded step leaves another {name} than the"
                    " step itself, as `advance` does work on the host or depends on the time; leave"
                    " out `repeats_from`"
                )
        return True
