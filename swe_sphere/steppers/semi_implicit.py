"""Semi-implicit leapfrog: gravity waves by the trapezoidal rule over two steps."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.model import Model
from swe_sphere.kernels.vectors import leapfrog_kernel
from swe_sphere.steppers.imex_runge_kutta import ARK2, ImexStepper
from swe_sphere.steppers.leapfrog import Leapfrog, filtered_growth
from swe_sphere.steppers.stability import Complex


class SemiImplicit(ImexStepper):
    """Semi-implicit leapfrog, Robert-Asselin-Williams filter: one right-hand side and one solve.

    (I - dt L) x+ = x- + 2 dt [F(x) - L x] + dt L x- (Robert 1969; Hoskins & Simmons 1975,
    doi:10.1002/qj.49710142918), solved for the change x+ - x-: its right-hand side is
    2 dt [F(x) + L (x- - x)], and the one change before is the guess.  Filter, drag and
    relaxation as in `leapfrog`; diffusion joins the right-hand side.  Started by ARK2.  The default
    tolerance leaves a hundredth of the error in time in williamson5 after 5 days.
    """

    name, order = "semi-implicit", 2
    memory = "state", "previous", "guess"  # the last change of depth
    levels = "state", "previous"
    diffusion_steps = 2
    holds_damping = True
    default_tolerance = 1e-2
    error_constant = 1.0 / 6.0  # leapfrog's, dt^3/3 of the third derivative, of a change of 2 dt
    style = ("#E69F00", "D")

    def __init__(
        self, model: Model, dt: float, tolerance: float | None = None, coriolis: str = "explicit"
    ) -> None:
        super().__init__(model, dt, tolerance, coriolis)
        self._starter = ARK2(model, dt, solver=self.solver)
        self.previous, self._slope, self._linear, self._change, self._difference = (
            model.zeros() for _ in range(5)
        )
        self.guess = wp.zeros_like(self._change[self._depth])
        self._kernel = leapfrog_kernel(model.device_mesh.real)
        model.launch.load(self._kernel)

    def begin(self, slope: wp.array) -> None:
        """Forget the change before."""
        self.guess.zero_()

    def advance(self) -> None:
        """Take a step from the past level; the first one by ARK2."""
        if self.steps == 0:
            self._first_step()
            return
        self.solver.aim(self.state, self.error_constant, self.order, self.dt)
        self.solver.waves.linearise(self.state)
        self._explicit_tendency()
        self.space.scale(2.0 * self.dt, self._slope)
        self.solver.solve(self.dt, self.time, self._slope, self.guess, self._change)
        wp.copy(self.guess, self._change[self._depth])
        self.model.launch(
            self._kernel, self.model.size, self.previous, self.state, self._change,
            1.0, 0.5 * Leapfrog.default_strength, Leapfrog.default_share,
        )  # fmt: skip
        self.solver.motion.accept(self.previous, self.state, self.dt)

    def _explicit_tendency(self) -> None:
        """slope = F(x) + L (x- - x), drag and relaxation from x-, and diffusion from there on."""
        self.model.conservative_tendency(self.state, self.time, self._slope)
        self.space.copy(self.previous, self._difference)
        self.space.axpy(-1.0, self.state, self._difference)
        self.solver.waves.apply(self._difference, self._linear)
        self.space.axpy(1.0, self._linear, self._slope)
        if self.model.dissipative:
            self.model.dissipative_tendency(self.previous, self._linear)
            self.space.axpy(1.0, self._linear, self._slope)
        if self.diffusion is not None:
            self.diffusion.join(self.previous, self._slope)

    def _first_step(self) -> None:
        wp.copy(self.previous, self.state)
        self._starter.start(self.state, self.time)
        self._starter.step()
        wp.copy(self.state, self._starter.state)
        self.space.copy(self.state, self._difference)
        self.space.axpby(-2.0, self.previous, 2.0, self._difference)
        wp.copy(self.guess, self._difference[self._depth])

    @classmethod
    def order_in(cls, model: Model, **options: Any) -> int:
        return 1 if Leapfrog.default_strength else super().order_in(model, **options)

    @classmethod
    def split_growth(
        cls, z_implicit: Complex, z_wave: Complex, z_dissipation: Complex
    ) -> NDArray[np.float64]:
        old = (1.0 + z_implicit + 2.0 * z_dissipation) / (1.0 - z_implicit)
        return filtered_growth(old, 2.0 * z_wave / (1.0 - z_implicit))
