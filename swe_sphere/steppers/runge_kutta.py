"""Explicit Runge-Kutta methods: a method is its Butcher tableau."""

from typing import ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.model import Model
from swe_sphere.steppers.stability import Complex, largest_step, runge_kutta_growth, tableau
from swe_sphere.steppers.stepper import Combiner, Stepper


class RungeKutta(Stepper):
    """Explicit Runge-Kutta method with stages K_i = F(x + dt sum_j a_ij K_j, t + c_i dt)."""

    a: ClassVar[tuple[tuple[float, ...], ...]]
    """Rows of the tableau below the diagonal, from the second stage on."""
    b: ClassVar[tuple[float, ...]]
    repeats_from = 0

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "name" in vars(cls):
            cls.vectors = 3 + len(cls.b)

    def __init__(self, model: Model, dt: float) -> None:
        super().__init__(model, dt)
        stages = len(self.b)
        stack = wp.zeros((stages, model.size), dtype=self.state.dtype, device=model.device)
        self._slopes = [stack[i] for i in range(stages)]
        self._stage = model.zeros()
        self._sums = [Combiner(model, stack, dt * np.array(row)) for row in (*self.a, self.b)]
        self._offsets = dt * np.array([0.0, *(sum(row) for row in self.a)])

    def _advance(self) -> None:
        t = self.time
        self.model.tendency(self.state, t, self._slopes[0])
        for i, combine in enumerate(self._sums[:-1], start=1):
            combine(self.state, self._stage)
            self.model.tendency(self._stage, t + self._offsets[i], self._slopes[i])
        self._sums[-1](self.state, self.state)

    @classmethod
    def stable_dt(cls, wave: float, dissipation: float = 0.0) -> float:
        """Largest step [s] with |R(z)| <= 1 over the spectrum."""
        a, b = tableau(cls.a, len(cls.b)), np.array(cls.b)

        def growth(z_wave: Complex, z_dissipation: Complex) -> NDArray[np.float64]:
            return runge_kutta_growth(b, (a, z_wave + z_dissipation))

        return largest_step(growth, wave, dissipation, reach=2.0 * len(b))


class RK4(RungeKutta):
    """Classical Runge-Kutta: four stages, fourth order; stable to 2.83 times the leapfrog limit."""

    name, order = "rk4", 4
    style = ("#0072B2", "o")
    expected_error = ((900.0, 2.941341e-07, 2.534993e-06), (450.0, 1.867172e-08, 1.596877e-07))
    a = ((1 / 2,), (0, 1 / 2), (0, 0, 1))
    b = (1 / 6, 1 / 3, 1 / 3, 1 / 6)


class SSPRK3(RungeKutta):
    """Strong-stability-preserving Runge-Kutta: three stages, third order (Shu & Osher 1988)."""

    name, order = "ssprk3", 3
    style = ("#56B4E9", "p")
    expected_error = ((900.0, 2.025637e-06, 2.439406e-05), (450.0, 2.618428e-07, 3.111915e-06))
    a = ((1,), (1 / 4, 1 / 4))
    b = (1 / 6, 1 / 6, 2 / 3)


class KG5(RungeKutta):
    """Kinnmark & Gray: five stages, third order, the longest explicit steps for waves.

    Guerra & Ullrich 2016 (doi:10.5194/gmd-9-2007-2016), eq. 56; after Kinnmark & Gray 1984.
    """

    name, order = "kg5", 3
    style = ("#0C0CE9", "h")
    expected_error = ((900.0, 3.951576e-07, 4.755524e-06), (450.0, 5.184853e-08, 6.174662e-07))
    a = ((1 / 5,), (0, 1 / 5), (0, 0, 1 / 3), (0, 0, 0, 2 / 3))
    b = (1 / 4, 0, 0, 0, 3 / 4)
