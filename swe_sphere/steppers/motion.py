"""How fast the state moves, and how fast that changes: what solver tolerances are tied to."""

import math
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.model import Model
from swe_sphere.solvers.vector_space import VectorSpace

SHARE = 0.45
"""Part of the least truncation error of a step that the solver may add to it."""
PROBE = 1e-2
"""Part of a time step after which the slope is looked at again to know its rate of change."""


class Motion:
    """Time derivatives of the state by differences of its mean slopes over the last steps.

    rate |x'| [m s-1 s-1 in the energy norm]; frequencies |x''|/|x'| and |x'''|/|x''| [s-1], of
    which the second is never less than the first for a sum of oscillations (Cauchy-Schwarz:
    |x''|^2 <= |x'| |x'''|, and so on for all derivatives).  A scheme of order p therefore leaves
    a truncation error of at least C f_1 f_2^(p-1) dt^p |x'| dt a step.
    """

    def __init__(self, space: VectorSpace) -> None:
        self._space = space
        self._slope, self._work = space.zeros(), space.zeros()
        self.bend = space.zeros()
        """x'' between the last two steps."""
        self.rate, self.last_dt = 0.0, 0.0
        """The latter is the length [s] of the last step, 0 before the first."""
        self.frequencies = (0.0, 0.0)

    def start(self, model: Model, state: wp.array, t: float, dt: float) -> wp.array:
        """Begin at a state at t [s], from which steps of dt [s] are to be taken; returns F there.

        The array returned is that of the slope, not a copy.
        """
        space, probe = self._space, PROBE * dt
        model.tendency(state, t, self._slope)
        space.copy(state, self._work)
        space.axpy(probe, self._slope, self._work)
        model.tendency(self._work, t + probe, self.bend)
        space.axpy(-1.0, self._slope, self.bend)
        self.rate, self.last_dt = space.norm(self._slope), 0.0
        frequency = _ratio(space.norm(self.bend), probe * self.rate)
        self.frequencies = frequency, frequency
        space.clear(self.bend)
        return self._slope

    def accept(self, old: wp.array, new: wp.array, dt: float) -> None:
        """Take note of a step of dt [s] between two states."""
        space, slope, bend, before = self._space, self._work, self._slope, self.bend
        apart = 0.5 * (dt + self.last_dt)
        space.copy(old, slope)
        space.axpby(1.0 / dt, new, -1.0 / dt, slope)
        space.axpby(1.0 / apart, slope, -1.0 / apart, bend)
        pairs = (bend, bend), (before, before), (bend, before), (slope, slope)
        now, then, both, square = map(float, space.dots(*pairs))
        self.rate = math.sqrt(square)
        first = _ratio(math.sqrt(now), self.rate)
        second = _ratio(math.sqrt(max(now - 2.0 * both + then, 0.0) / now), dt) if now else first
        self.frequencies = first, (max(first, second) if then else first)
        self._slope, self.bend, self._work, self.last_dt = slope, bend, before, dt

    def truncation(self, constant: float, order: int, dt: float) -> float:
        """What a solver may leave of a step of dt [s] by a scheme with that error constant C.

        It is `SHARE` of the least truncation error, relative to the change over the step.
        """
        first, second = (min(1.0, f * dt) for f in self.frequencies)
        return SHARE * constant * first * float(second ** (order - 1))

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """What an exact restart needs."""
        numbers = np.array([self.rate, self.last_dt, *self.frequencies])
        vectors = {"mean_slope": self._slope, "bend": self.bend}
        return {"motion": numbers} | {k: self._space.saved(v) for k, v in vectors.items()}

    def load_state_dict(self, saved: dict[str, NDArray[Any]]) -> None:
        """Go on from what `state_dict` returned."""
        numbers = (float(number) for number in saved["motion"])
        self.rate, self.last_dt, *frequencies = numbers
        self.frequencies = frequencies[0], frequencies[1]
        self._space.load(saved["mean_slope"], self._slope)
        self._space.load(saved["bend"], self.bend)


def _ratio(above: float, below: float) -> float:
    """Their quotient; 0 where there is nothing above, infinite where only there is something."""
    if above == 0.0:
        return 0.0
    return above / below if below > 0.0 else math.inf
