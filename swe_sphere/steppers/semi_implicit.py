"""Semi-implicit leapfrog: gravity waves by the trapezoidal rule over two steps."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.model import Model
from swe_sphere.kernels.vectors import leapfrog_kernel
from swe_sphere.steppers.imex_runge_kutta import ARK2
from swe_sphere.steppers.imex_stepper import ImexStepper, depth_of
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
    diffusion_steps = 2
    holds_damping = True
    default_tolerance = 1e-2
    vectors = ARK2.vectors + 26  # with the room of the second set-up
    error_constant = 1.0 / 6.0  # leapfrog's, dt^3/3 of the third derivative, of a change of 2 dt
    style = ("#E69F00", "D")
    expected_error = ((900.0, 5.462867e-05, 1.128908e-03), (450.0, 1.447359e-05, 3.498897e-04))

    def _allocate(self, model: Model) -> None:
        self._starter = ARK2(model, self.dt, solver=self.solver)
        # which take note of its step
        self._starter.motion, self._starter.counters = self.motion, self.counters
        self._previous, self._slope, self._linear = model.zeros(), model.zeros(), model.zeros()
        self._change, self._difference = model.zeros(), model.zeros()
        real, n = model.device_mesh.real, model.device_mesh.size
        self._guess = wp.zeros(n, dtype=real, device=model.device)
        self._kernel = leapfrog_kernel(real)
        model.launch.load(self._kernel)

    def start(self, state: wp.array, t: float = 0.0) -> None:
        """Begin from a copy of the state at time t [s]."""
        super().start(state, t)
        self._guess.zero_()

    @property
    def levels(self) -> tuple[wp.array, ...]:
        """The present and the past state."""
        return self.state, self._previous

    def _remembered(self) -> dict[str, wp.array]:
        return {"state": self.state, "previous": self._previous, "guess": self._guess}

    def _advance(self) -> None:
        if self.steps == 0:
            self._first_step()
            return
        self.waves.linearise(self.state)
        self._explicit_tendency()
        self.space.scale(2.0 * self.dt, self._slope)
        self._solve(self.dt, self._slope, self._guess, self._change)
        wp.copy(self._guess, depth_of(self._change, self._guess.size))
        self.model.launch(
            self._kernel, self.model.size, self._previous, self.state, self._change,
            1.0, 0.5 * Leapfrog.default_strength, Leapfrog.default_share,
        )  # fmt: skip
        self.motion.accept(self._previous, self.state, self.dt)

    def _explicit_tendency(self) -> None:
        """slope = F(x) + L (x- - x), drag and relaxation from x-, and diffusion from there on."""
        self.model.conservative_tendency(self.state, self.time, self._slope)
        self.space.copy(self._previous, self._difference)
        self.space.axpy(-1.0, self.state, self._difference)
        self.waves.apply(self._difference, self._linear)
        self.space.axpy(1.0, self._linear, self._slope)
        if self.model.dissipative:
            self.model.dissipative_tendency(self._previous, self._linear)
            self.space.axpy(1.0, self._linear, self._slope)
        if self.diffusion is not None:
            self.diffusion.join(self._previous, self._slope)

    def _first_step(self) -> None:
        wp.copy(self._previous, self.state)
        self._starter.start(self.state, self.time)
        self._starter.step()
        wp.copy(self.state, self._starter.state)
        self.space.copy(self.state, self._difference)
        self.space.axpby(-2.0, self._previous, 2.0, self._difference)
        wp.copy(self._guess, depth_of(self._difference, self._guess.size))

    @classmethod
    def order_in(cls, model: Model, **options: Any) -> int:
        """One with the filter."""
        return 1 if Leapfrog.default_strength else super().order_in(model, **options)

    @classmethod
    def _growth(
        cls, z_implicit: Complex, z_wave: Complex, z_dissipation: Complex
    ) -> NDArray[np.float64]:
        old = (1.0 + z_implicit + 2.0 * z_dissipation) / (1.0 - z_implicit)
        return filtered_growth(old, 2.0 * z_wave / (1.0 - z_implicit))
