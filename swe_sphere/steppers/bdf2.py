"""The backward differentiation formula of second order."""

import warp as wp

from swe_sphere.errors import ConfigError
from swe_sphere.steppers.dirk import TRBDF2
from swe_sphere.steppers.variable_stepper import ImplicitStepper

EXPECTED = 0.3
"""Part of the last change of slope that the guess expects again.  Slow flow would have all of it,
but so it would double the noise of waves that steps do not resolve."""


class BDF2(ImplicitStepper):
    """BDF2: second order, one solve a step, damps fast waves; started by TR-BDF2.

    Variable steps: with w the ratio of the step to the one before,
    x+ - dt (1+w)/(1+2w) F(x+) = [(1+w)^2 x - w^2 x-]/(1+2w) (Hairer, Norsett & Wanner 1993, III.5).
    """

    name, order = "bdf2", 2
    style = ("#516CF6", "^")
    default_tolerance = 1e-2
    memory = "state", "previous"
    error_constant = 2.0 / 9.0  # for equal steps (Hairer, Norsett & Wanner 1993, III.2)

    def allocate(self) -> None:
        if self.diffusion_apart:
            raise ConfigError("bdf2: diffusion apart would be of first order: take it whole")
        self.previous, self._rhs = self.model.zeros(), self.model.zeros()
        self._starter = TRBDF2(self.model, self.dt, solver=self.solver)

    def solve_step(self, t: float, dt: float, out: wp.array) -> str | None:
        before = self.solver.last_dt
        if before == 0.0:
            starter = self._starter
            starter.start(self.state, t)
            self.solver.aim(starter.state, starter.error_constant, starter.order, dt)
            # a few more iterations with the set-up of the steps to come cost less than another one
            self.solver.prepared_for = 2.0 / 3.0 * dt
            try:
                return starter.solve_step(t, dt, out)
            finally:
                self.solver.prepared_for = None
        w = dt / before
        now, past = (1.0 + w) ** 2 / (1.0 + 2.0 * w), -(w**2) / (1.0 + 2.0 * w)
        self.space.copy(self.state, self._rhs)
        self.space.axpby(past, self.previous, now, self._rhs)
        self.space.copy(self.state, out)
        self.space.axpby(-w, self.previous, 1.0 + w, out)
        self.space.axpy(0.5 * EXPECTED * dt * (dt + before), self.solver.bend, out)
        return self.solver.solve(dt * (1.0 + w) / (1.0 + 2.0 * w), t + dt, self._rhs, out)

    def accept(self, dt: float) -> None:
        self.space.copy(self.state, self.previous)
        super().accept(dt)
