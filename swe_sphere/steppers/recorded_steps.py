"""Steps that are recorded and repeated, and a check that those of a custom stepper may be."""

from collections import Counter
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from swe_sphere.errors import ConfigError
from swe_sphere.operators.replay import Replay

if TYPE_CHECKING:
    from swe_sphere.steppers.stepper import Stepper

__all__ = ["CheckedReplay", "Replay"]

FIRST_REPEAT = 3
"""A step is run, recorded, and repeated from its third time on."""


class CheckedReplay:
    """A replay whose first repetition is compared with the step itself, bit for bit.

    Work that a step does on the host, and numbers that change from step to step, are not recorded.
    Raises ConfigError where the repetition differs.
    """

    def __init__(self, replay: Replay, stepper: "Stepper") -> None:
        self._replay, self._stepper = replay, stepper
        self._calls: Counter[int] = Counter()

    def __call__(self, key: int, advance: Callable[[], None]) -> None:
        """Repeat `advance`, which is known by a key."""
        self._calls[key] += 1
        if self._calls[key] != FIRST_REPEAT or not self._stepper.model.launch.records:
            self._replay(key, advance)
            return
        counters = self._stepper.model.counters
        arrays, counted = self._stepper.arrays(), dict(counters)
        before = [wp.clone(array) for array in arrays.values()]
        self._replay(key, advance)
        repeated = [array.numpy().copy() for array in arrays.values()]
        counters.update(counted)
        for array, values in zip(arrays.values(), before, strict=True):
            wp.copy(array, values)
        advance()
        for (name, array), values in zip(arrays.items(), repeated, strict=True):
            if not np.array_equal(array.numpy(), values, equal_nan=True):
                raise ConfigError(
                    f"stepper {self._stepper.name}: a recorded step leaves another {name} than the"
                    " step itself, as `advance` does work on the host or depends on the time; leave"
                    " out `repeats_from`"
                )
