"""Leapfrog with the Robert-Asselin-Williams filter."""

from typing import Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.model import Model
from swe_sphere.kernels.vectors import leapfrog_kernel
from swe_sphere.steppers.combinations import Combiner
from swe_sphere.steppers.runge_kutta import RK4
from swe_sphere.steppers.stability import Complex, largest_eigenvalue
from swe_sphere.steppers.stepper import Stepper


class Leapfrog(Stepper):
    """Leapfrog with Robert-Asselin-Williams filter: one right-hand side a step, started by rk4.

    Williams 2009 (doi:10.1175/2009MWR2724.1).  Drag and relaxation are taken at the past level,
    where they are stable; diffusion acts over the two steps from there.  Another filter than the
    usual one (strength 0: none) is for comparison with other models at a given step: `stable_dt` is
    that of the usual one.
    """

    name, order = "leapfrog", 2
    memory = levels = "state", "previous"
    diffusion_steps = 2
    holds_damping = True
    repeats_from = 1
    reach = 2.0
    style = ("#D55E00", "s")

    default_strength: ClassVar[float] = 0.1
    """Strength nu of the filter (Robert's coefficient 0.05 in other notation)."""
    default_share: ClassVar[float] = 0.7
    """Williams' alpha: part of the displacement given to the present level (1: Robert-Asselin)."""

    def __init__(
        self, model: Model, dt: float, strength: float | None = None, share: float | None = None
    ) -> None:
        super().__init__(model, dt)
        self._displacement = 0.5 * (self.default_strength if strength is None else strength)
        self._share = self.default_share if share is None else share
        self.previous, self._slope = model.zeros(), model.zeros()
        self._damping = wp.zeros((1, model.size), dtype=self.state.dtype, device=model.device)
        self._add_damping = Combiner(model, self._damping, np.ones(1))
        self._starter = RK4(model, dt)
        real = model.device_mesh.real
        self._kernel = leapfrog_kernel(real)
        model.launch.load(self._kernel)

    def advance(self) -> None:
        """Take a step from the past level; the first one by rk4."""
        if self.steps == 0:
            self._first_step()
            return
        self.model.conservative_tendency(self.state, self.time, self._slope)
        if self.model.dissipative:
            self.model.dissipative_tendency(self.previous, self._damping[0])
            self._add_damping(self._slope, self._slope)
        if self.diffusion is not None:
            self.diffusion.join(self.previous, self._slope)
        self.model.launch(
            self._kernel, self.model.size, self.previous, self.state, self._slope,
            2.0 * self.dt, self._displacement, self._share,
        )  # fmt: skip

    def _first_step(self) -> None:
        wp.copy(self.previous, self.state)
        self._starter.start(self.state, self.time)
        self._starter.step()
        wp.copy(self.state, self._starter.state)

    @classmethod
    def order_in(cls, model: Model, **options: Any) -> int:
        strength = options.get("strength")
        filtered = cls.default_strength if strength is None else strength
        return 1 if filtered else super().order_in(model, **options)

    @classmethod
    def growth(cls, z_wave: Complex, z_dissipation: Complex) -> NDArray[np.float64]:
        return filtered_growth(1.0 + 2.0 * z_dissipation, 2.0 * z_wave)


def filtered_growth(old: Complex, new: Complex) -> NDArray[np.float64]:
    """Largest growth with the filter of the scheme x+ = old x- + new x.

    Its levels are rows of weights of (x-, x), which a step with the filter's displacement
    D = strength / 2 (x- - 2 x + x+) takes to (x + share D, x+ - (1 - share) D).
    """
    half, share = 0.5 * Leapfrog.default_strength, Leapfrog.default_share
    past, present = np.eye(2)
    future = np.stack(np.broadcast_arrays(old, new), axis=-1)
    moved = half * (past - 2.0 * present + future)
    step = np.stack([present + share * moved, future - (1.0 - share) * moved], axis=-2)
    return largest_eigenvalue(step)
