"""The base of implicit methods, which solve the equations of their stages by Newton-Krylov."""

from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np
import warp as wp

from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError
from swe_sphere.solvers.linear_result import LinearResult
from swe_sphere.solvers.newton import NewtonResult
from swe_sphere.steppers.newton_stages import NewtonStages, StageProblem
from swe_sphere.steppers.stepper import Stepper
from swe_sphere.steppers.sub_steps import step_in_parts

DIFFUSION = ("whole", "apart")
"""Whether viscosity and hyperviscosity are part of the implicit equations, or split off."""

Failure = NewtonResult | LinearResult
"""The solve for which a step could not be taken."""


class ImplicitStepper(Stepper):
    """An implicit method: `solve_step` takes a step of any length with `solver`.

    solver: the one of another stepper of the same model, to share it with its options.
    """

    family = "implicit"
    diffusion_apart = False
    equations: ClassVar[type[Any]] = StageProblem
    """The equations of a stage."""
    solver: NewtonStages

    def __init__(
        self,
        model: Model,
        dt: float,
        tolerance: float | None = None,
        preconditioner: str = "helmholtz",
        diffusion: str = "whole",
        krylov_block: int = 1,
        solver: NewtonStages | None = None,
    ) -> None:
        if diffusion not in DIFFUSION:
            raise ConfigError(f"diffusion is {' or '.join(DIFFUSION)}, not {diffusion!r}")
        self.diffusion_apart = diffusion == "apart"
        super().__init__(model, dt)
        self.solver = solver or NewtonStages(
            self.model, self, tolerance, preconditioner, krylov_block, self.equations
        )
        self.counters, self.space = self.solver.counters, self.solver.space
        self.new: wp.array = self.model.zeros()
        """The state after the step last attempted."""
        self.allocate()

    def allocate(self) -> None:
        """Make the arrays of the method, which has its model and solver already."""

    advance = step_in_parts

    @classmethod
    def stable_dt(cls, wave: float, dissipation: float = 0.0) -> float:
        """Infinite: the step is limited by accuracy alone."""
        return np.inf

    def attempt(self, t: float, dt: float) -> str | None:
        """Write the state one step dt [s] after `state`, at t [s], to `new`.

        Returns what is wrong with it, in words; `state` has not changed before `accept`.
        """
        newton = self.solver.newton
        known = newton.nonlinearity
        self.solver.aim(self, dt)
        failure = self.solve_step(t, dt, self.new)
        fault = failure.message if failure else self.solver.fault(self.new)
        if fault is not None:
            newton.nonlinearity = known
        return fault

    @abstractmethod
    def solve_step(self, t: float, dt: float, out: wp.array) -> Failure | None:
        """Write the state one step dt [s] after `state`, at t [s], to `out`.

        Returns the result of the solve that failed, if one did.
        """

    def accept(self, dt: float) -> None:
        """Make `new`, a step of dt [s] on, the present state, and remember how fast it moved."""
        self.solver.motion.accept(self.state, self.new, dt)
        self.space.copy(self.new, self.state)

    def error_estimate(self) -> float:
        """Norm [m s-1] of the error of the step last attempted, if `estimate_order` is not None."""
        raise NotImplementedError

    def implied_slope(self, x: wp.array, rhs: wp.array, tau: float, out: wp.array) -> None:
        """out = (x - rhs)/tau: F(x) as the solved stage equation implies it, mass included."""
        self.space.copy(x, out)
        self.space.axpby(-1.0 / tau, rhs, 1.0 / tau, out)
