"""Implicit steppers: the equations of a stage, their Newton-Krylov solver, steps of any length."""

import math
from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, Literal

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.effects import MASSES
from swe_sphere.equations.model import Model
from swe_sphere.equations.spectrum import SpectralRadii
from swe_sphere.errors import ConfigError, SolverFailed
from swe_sphere.ranks.limits import check_stop
from swe_sphere.solvers.krylov import FlexibleGMRES
from swe_sphere.solvers.newton import NewtonKrylov
from swe_sphere.solvers.preconditioners import Preconditioner, make_preconditioner
from swe_sphere.solvers.vector_space import Masses, VectorSpace
from swe_sphere.steppers.split_diffusion import HeldPenalty
from swe_sphere.steppers.stage_solver import StageSolver, energy_space
from swe_sphere.steppers.stepper import Family, Stepper, Trajectory

KRYLOV_SIZE = 200
KRYLOV_MEMORY = 2e9
"""Most basis vectors of GMRES, and the largest memory [bytes] of more than 20 of them."""
NEWTON_ITERATIONS = 12
"""Largest number of Newton iterations; beyond it two half steps cost less."""
MOST_STEP_PARTS = 64
"""Largest number of parts into which repeated halving divides a step whose solve fails."""


class StageProblem:
    """x - tau F(x, t) = rhs, with the Jacobian products of `Model.jacobian`.

    `space` contains x, `linear_space` the vectors of linear solves, see `Model.for_solves`.
    """

    tau_factor: ClassVar[float] = 1.0
    """Factor of tau F in the residual."""
    tau, time = 0.0, 0.0
    rhs: wp.array = None

    def __init__(self, model: Model, space: VectorSpace, preconditioner: str) -> None:
        linear = model.for_solves
        self._model, self.space = model, space
        self.linear_space = space if linear is model else energy_space(linear)
        self.precondition: Preconditioner | None = make_preconditioner(preconditioner, linear)
        self._slope, self._operator = model.zeros(), linear.jacobian()
        self.converted = self.linear_space.converted

    def residual(self, x: wp.array, out: wp.array) -> None:
        """Set out = x - tau F(x) - rhs."""
        self._evaluate(x)
        factor = -self.tau_factor * self.tau
        self._model.launch.combine(x, self._slope, factor, self.rhs, -1.0, out=out)

    def _evaluate(self, x: wp.array) -> None:
        self._model.tendency(x, self.time, self._slope)

    def linearise(self, x: wp.array) -> None:
        self._operator.update(self.converted(x), self.time)

    def jacobian(self, d: wp.array, out: wp.array) -> None:
        """Set out = d - tau J d."""
        self._operator(d, out)
        self.linear_space.axpby(1.0, d, -self.tau, out)

    def masses(self, x: wp.array) -> list[tuple[wp.array, wp.array, float]]:
        """Return states whose masses follow from a source: (source, state, gain in depth [m])."""
        return [(self.rhs, x, self.tau_factor * self.tau * self._model.mean_source(self.time))]


class NewtonStages(StageSolver):
    """Solver of the nonlinear equations of implicit stages, and of their linearised form.

    equations: class of the problem, called with the model, the space and the preconditioner's name.
    """

    prepared_for: float | None = None
    """Implicit step tau [s] for which the preconditioner is set up; None: the tau of the stage."""

    def __init__(
        self, model: Model, tolerance: float, preconditioner: str, equations: type[StageProblem]
    ) -> None:
        super().__init__(model, tolerance)
        self.problem = equations(model, self.space, preconditioner)
        space = self.problem.linear_space
        # a large basis pays at large advective Courant numbers; it has the same size on any number
        # of ranks, so that they agree when to restart
        most = KRYLOV_MEMORY / (2 * space.dtype.itemsize * space.global_size)
        gmres = FlexibleGMRES(space, max(20, min(KRYLOV_SIZE, int(most))))
        self.newton = NewtonKrylov(self.problem.space, gmres, NEWTON_ITERATIONS, 2 * KRYLOV_SIZE)
        self.counters |= {"rejected_steps": 0, "newton_iterations": 0}
        self._known = self.newton.nonlinearity
        self._masses = Masses(model.device_mesh)
        kept = MASSES.intersection(*(effect.conserves for effect in model.scene.effects))
        self._conserved = [
            (block, name) for block, name in enumerate(model.names)
            if name not in ("u", "v") and ("mass" if name == "h" else "tracers") in kept
        ]  # fmt: skip
        """Numbers and names of the blocks whose masses all effects conserve."""

    def start(self, state: wp.array, t: float, dt: float) -> wp.array:
        if self.problem.precondition is not None:
            self.problem.precondition.load_state_dict({})
        self.newton.nonlinearity = 0.0 if self.model.scene.linear else None
        return super().start(state, t, dt)

    def aim(self, state: wp.array, error_constant: float, order: int, dt: float) -> None:
        super().aim(state, error_constant, order, dt)
        self._known = self.newton.nonlinearity

    def reject(self) -> None:
        self.newton.nonlinearity = self._known

    def solve(self, tau: float, t: float, rhs: wp.array, x: wp.array) -> str | None:
        """Solve the problem for the implicit step tau [s] at the time t [s] from the guess x.

        x becomes the solution, with the masses of the exact one. Returns the reason of a failure.
        """
        problem = self.problem
        problem.tau, problem.time, problem.rhs = tau, t, rhs
        if problem.precondition is not None:
            point = problem.converted(self.model.point_of_tangent(self.state))
            problem.precondition.update(point, self.prepared_for or tau)
        scale, floor = tau * self.rate, self.residual_floor()
        result = self.newton.solve(problem, x, self.tolerance, scale, floor)
        self.counters["newton_iterations"] += result.newton_iterations
        self.counters["krylov_iterations"] += result.krylov_iterations
        if not result.converged:
            return result.message
        for source, state, gain in problem.masses(x):  # forcing contains no tracer
            for block, name in self._conserved:
                self._masses.restore(source, state, block, gain if name == "h" else 0.0)
        return None

    def norm_of_solution(self, tau: float, state: wp.array, rhs: wp.array, rtol: float) -> float:
        """Return |x| of (I - tau J) x = rhs, J at a state; it is infinite if the solve fails."""
        problem = self.problem
        problem.tau, x = tau, problem.linear_space.zeros()
        problem.linearise(state)
        result = self.newton.gmres.solve(
            problem.jacobian, problem.converted(rhs), x, problem.precondition, rtol,
            max_iterations=self.newton.max_krylov, guess=False,
        )  # fmt: skip
        self.counters["krylov_iterations"] += result.iterations
        return problem.linear_space.norm(x) if result.converged else math.inf

    def numbers(self) -> dict[str, NDArray[Any]]:
        made, known = self.problem.precondition, self.newton.nonlinearity
        saved = super().numbers() | ({} if made is None else made.state_dict())
        return saved | {"nonlinearity": np.array(-1.0 if known is None else known)}

    def load_numbers(self, saved: dict[str, NDArray[Any]]) -> None:
        super().load_numbers(saved)
        known = float(saved["nonlinearity"])
        self.newton.nonlinearity = known if known >= 0.0 else None
        if self.problem.precondition is not None:
            self.problem.precondition.load_state_dict(saved)


class VariableStepper(Stepper):
    """A stepper that takes steps of any length by `solve_step`, with a solver of their equations.

    A step of dt whose solve fails is divided.
    """

    family: ClassVar[Family] = "implicit"
    can_give_up = True
    splits_diffusion = False
    solver: StageSolver

    @classmethod
    def complete(cls) -> None:
        if not hasattr(cls, "error_constant"):
            raise ConfigError(
                f"stepper {cls.name} has no `error_constant`, which the tolerance of its solver"
                " follows: define it beside its name"
            )

    def __init__(self, model: Model, dt: float, solver: StageSolver) -> None:
        super().__init__(model, dt)
        self.solver, self.space = solver, solver.space
        self.new: wp.array = self.model.zeros()
        """The state after the step last attempted."""

    def advance(self) -> None:
        """Take a step of dt; each failed solve halves the parts in which the rest of it is taken.

        Raises SolverFailed, and restores the state, if the smallest parts fail.
        """
        done, parts = 0, 1
        while done < parts:
            dt = self.dt / parts
            if (fault := self.attempt(self.time + done * dt, dt)) is None:
                self.accept(dt)
                done += 1
                continue
            if parts == 1:
                restore = self.restore_point()
            self.counters["rejected_steps"] += 1
            done, parts = 2 * done, 2 * parts
            if parts > MOST_STEP_PARTS:
                restore()
                raise SolverFailed(
                    f"{self.name}: the step from {self.time:.0f} s cannot be solved even in "
                    f"{parts // 2} parts: {fault}; choose a smaller --dt"
                )

    def follow(self, earlier: Trajectory, t: float) -> None:
        self.load_state_dict(earlier.state_dict() | {"origin": np.array(t)}, 0)

    @classmethod
    def spectral_radii(cls, model: Model, state: wp.array, t: float = 0.0) -> SpectralRadii:
        return SpectralRadii(0.0)  # not computed, because accuracy alone limits the step

    def attempt(self, t: float, dt: float) -> str | None:
        """Write the state one step dt [s] after `state`, at t [s], to `new`.

        Returns the fault of the new state, if any; `state` does not change before `accept`.
        """
        check_stop()
        self.hold(dt)
        self.solver.aim(self.state, self.error_constant, self.order, dt)
        fault = self.solve_step(t, dt, self.new) or self.solver.fault(self.new)
        if fault:
            self.solver.reject()
        return fault

    def hold(self, dt: float) -> None:
        """Compute the terms that stay constant in a step of dt [s] from `state`."""

    @abstractmethod
    def solve_step(self, t: float, dt: float, out: wp.array) -> str | None:
        """Write the state one step dt [s] after `state`, at t [s], to `out`.

        Returns the reason of a failed solve, if one failed.
        """

    def accept(self, dt: float) -> None:
        """Exchange `state` and `new`, a step of dt [s] on, and record the rate of change."""
        self.solver.accept(self.state, self.new, dt)
        self.state, self.new = self.new, self.state


class ImplicitStepper(VariableStepper):
    """A stepper with a Newton-Krylov solver of its equations.

    `tolerance`: see `StageSolver`; `diffusion`: "whole" if viscosity and hyperviscosity are part of
    the implicit equations, "apart" if they are stepped separately; `solver`: the solver of another
    stepper of the same model, to be shared; its tolerance and preconditioner then apply.
    """

    equations: ClassVar[type[StageProblem]] = StageProblem
    """The equations of an implicit stage."""
    splits_penalty = False  # safe for any method
    penalised_at: ClassVar[float] = 0.5
    """Time of the state whose edge penalty a step holds, in steps after its start."""
    solver: NewtonStages
    guesses: Sequence[wp.array] = ()
    """Slopes of the last step, from which stages are guessed."""

    def __init__(
        self, model: Model, dt: float, tolerance: float | None = None,
        preconditioner: str = "helmholtz", diffusion: Literal["whole", "apart"] = "whole",
        solver: NewtonStages | None = None,
    ) -> None:  # fmt: skip
        self.splits_diffusion = diffusion == "apart"
        self._held = HeldPenalty(model, dt) if model.penalised and self.splits_penalty else None
        if self._held is not None:
            model = model.unpenalised(self._held.rate)
        if solver is None:
            own, tolerance = self.stage_model(model), self.solver_tolerance(tolerance)
            solver = NewtonStages(own, tolerance, preconditioner, self.equations)
        super().__init__(model, dt, solver)
        self.allocate()

    def start(self, state: wp.array, t: float = 0.0) -> None:
        if self._held is not None:
            self._held.rate.zero_()
        super().start(state, t)

    def hold(self, dt: float) -> None:
        if self._held is not None:
            self._held.find(self.state, self.solver.mean_slope, self.penalised_at * dt, dt)

    def make_guesses(self, slope: wp.array) -> None:
        """Guess the initial slope for all stages."""
        for guess in self.guesses:
            self.space.copy(slope, guess)

    def error_estimate(self) -> float:
        """Return the norm [m s-1] of the last attempt's error, if `estimate_order` is not None."""
        raise NotImplementedError

    def implied_slope(self, x: wp.array, rhs: wp.array, tau: float, out: wp.array) -> None:
        """Set out = (x - rhs)/tau: F(x) as the solved stage equation implies it, mass included."""
        self.space.axpby(-1.0 / tau, rhs, 1.0 / tau, x, out)
