"""The bases of methods that take steps of any length, with a solver of their equations."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
import warp as wp

from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError, SolverFailed
from swe_sphere.steppers.newton_stages import NewtonStages, StageProblem
from swe_sphere.steppers.stage_solver import StageSolver
from swe_sphere.steppers.stepper import Family, Stepper

DIFFUSION = ("whole", "apart")
"""Whether viscosity and hyperviscosity are part of the implicit equations, or split off."""
MOST_STEP_PARTS = 64
"""A step that cannot be solved is halved, and halved again, into at most this many parts."""


class VariableStepper(Stepper):
    """A stepper that takes steps of any length by `solve_step`, with a solver of their equations.

    A step of dt that cannot be solved is taken in parts.
    """

    family: ClassVar[Family] = "implicit"
    diffusion_apart = False
    solver: StageSolver

    def __init__(self, model: Model, dt: float, solver: StageSolver) -> None:
        super().__init__(model, dt)
        self.solver, self.counters, self.space = solver, solver.counters, solver.space
        self.new: wp.array = self.model.zeros()
        """The state after the step last attempted."""

    def advance(self) -> None:
        """Take a step of dt, or as many equal parts of it as its solver needs.

        Raises SolverFailed, with the state as it was, where the smallest parts fail.
        """
        done, parts, start = 0, 1, self.state
        while done < parts:
            dt = self.dt / parts
            fault = self.attempt(self.time + done * dt, dt)
            if fault is None:
                self.accept(dt)
                done += 1
                continue
            start = wp.clone(self.state) if parts == 1 else start
            self.counters["rejected_steps"] += 1
            done, parts = 2 * done, 2 * parts
            if parts > MOST_STEP_PARTS:
                wp.copy(self.state, start)
                raise SolverFailed(
                    f"{self.name}: the step from {self.time:.0f} s cannot be solved even in "
                    f"{parts // 2} parts: {fault}; choose a smaller --dt"
                )

    @classmethod
    def stable_dt(cls, wave: float, dissipation: float = 0.0) -> float:
        """Infinite: the step is limited by accuracy alone."""
        return np.inf

    def attempt(self, t: float, dt: float) -> str | None:
        """Write the state one step dt [s] after `state`, at t [s], to `new`.

        Returns what is wrong with it, in words; `state` has not changed before `accept`.
        """
        self.solver.aim(self.state, self.error_constant, self.order, dt)
        fault = self.solve_step(t, dt, self.new) or self.solver.fault(self.new)
        if fault:
            self.solver.reject()
        return fault

    @abstractmethod
    def solve_step(self, t: float, dt: float, out: wp.array) -> str | None:
        """Write the state one step dt [s] after `state`, at t [s], to `out`.

        Returns why a solve failed, in words, if one did.
        """

    def accept(self, dt: float) -> None:
        """Make `new`, a step of dt [s] on, the present state, and remember how fast it moved."""
        self.solver.accept(self.state, self.new, dt)
        self.space.copy(self.new, self.state)


class ImplicitStepper(VariableStepper):
    """A stepper with a Newton-Krylov solver of its equations.

    `tolerance`: see `StageSolver`; `solver`: the one of another stepper of the same model, to share
    it with its options.
    """

    equations: ClassVar[type[StageProblem]] = StageProblem
    """The equations of an implicit stage."""
    solver: NewtonStages
    guesses: Sequence[wp.array] = ()
    """Slopes from which stages are guessed, those of the last step."""

    def __init__(
        self, model: Model, dt: float, tolerance: float | None = None,
        preconditioner: str = "helmholtz", diffusion: str = "whole",
        solver: NewtonStages | None = None,
    ) -> None:  # fmt: skip
        if diffusion not in DIFFUSION:
            raise ConfigError(f"diffusion is {' or '.join(DIFFUSION)}, not {diffusion!r}")
        self.diffusion_apart = diffusion == "apart"
        solver = solver or NewtonStages(
            model.inviscid if self.diffusion_apart else model, self.solver_tolerance(tolerance),
            preconditioner, self.equations,
        )  # fmt: skip
        super().__init__(model, dt, solver)
        self.allocate()

    def allocate(self) -> None:
        """Make the arrays of the method, which has its model and solver already."""

    def begin(self, slope: wp.array) -> None:
        """Guess the slope at the start for all stages."""
        for guess in self.guesses:
            self.space.copy(slope, guess)

    def error_estimate(self) -> float:
        """Norm [m s-1] of the error of the step last attempted, if `estimate_order` is not None."""
        raise NotImplementedError

    def implied_slope(self, x: wp.array, rhs: wp.array, tau: float, out: wp.array) -> None:
        """out = (x - rhs)/tau: F(x) as the solved stage equation implies it, mass included."""
        self.space.copy(x, out)
        self.space.axpby(-1.0 / tau, rhs, 1.0 / tau, out)
