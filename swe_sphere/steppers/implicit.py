"""What all implicit steppers share: one nonlinear solver and what to do when it fails."""

from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.effects import MASSES
from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError
from swe_sphere.kernels import combine_kernel
from swe_sphere.solvers.gmres import FlexibleGMRES
from swe_sphere.solvers.linear_result import LinearResult
from swe_sphere.solvers.newton import NewtonKrylov, NewtonResult
from swe_sphere.solvers.newton_steps import FollowedNonlinearity
from swe_sphere.solvers.preconditioners import make_preconditioner
from swe_sphere.solvers.vector_space import VectorSpace
from swe_sphere.steppers.solving import SteppedInParts

KRYLOV_SIZE = 200
KRYLOV_MEMORY = 2e9
"""Basis vectors kept by GMRES, and the memory they may take [bytes]."""
NEWTON_ITERATIONS = 12
"""A solve that needs more is cheaper in two halves of the step."""
FORCING = FollowedNonlinearity(first=0.02)
WORTHLESS = 0.3
"""Residuals below so many round-offs of the state are worth one iteration, not two: rounding alone
leaves as much.  With more they add up, in float32, where steps are short."""

DIFFUSION = ("whole", "apart")
"""How viscosity and hyperviscosity may be taken."""

Failure = NewtonResult | LinearResult
"""Why a step could not be taken."""


class StageProblem:
    """x - tau F(x, t) = r with exact Jacobian products."""

    slopes: ClassVar[float] = 1.0
    """How many times tau the slope in the residual is taken."""

    def __init__(self, model: Model, space: VectorSpace, preconditioner_name: str) -> None:
        self._model, self.space = model, space
        self.preconditioner = make_preconditioner(preconditioner_name, model)
        self.precondition = self.preconditioner
        self._slope, self._operator = model.zeros(), model.jacobian()
        self._add = combine_kernel(model.device_mesh.real, 2)
        model.launch.load(self._add)
        self.tau, self.time = 0.0, 0.0
        self.rhs: wp.array = None

    def residual(self, x: wp.array, out: wp.array) -> None:
        """out = x - tau F(x) - r."""
        self._evaluate(x)
        factor = -self.slopes * self.tau
        self._model.launch(self._add, x.size, x, self._slope, factor, self.rhs, -1.0, out)

    def _evaluate(self, x: wp.array) -> None:
        self._model.tendency(x, self.time, self._slope)

    def linearise(self, x: wp.array) -> None:
        """Fix the state of the Jacobian."""
        self._operator.update(x, self.time)

    def jacobian(self, d: wp.array, out: wp.array) -> None:
        """out = d - tau J d."""
        self._operator(d, out)
        self.space.axpby(1.0, d, -self.tau, out)


class ImplicitStepper(SteppedInParts):
    """An implicit method: subclasses take a step of any length with `_solve`."""

    family = "implicit"
    diffusion_apart = False
    prepared_for: float | None = None
    """The tau [s] that the preconditioner is set up for; None: that of the stage."""

    def __init__(
        self,
        model: Model,
        dt: float,
        tolerance: float | None = None,
        preconditioner: str = "helmholtz",
        diffusion: str = "whole",
        krylov_block: int = 1,
    ) -> None:
        if diffusion not in DIFFUSION:
            raise ConfigError(f"diffusion is {' or '.join(DIFFUSION)}, not {diffusion!r}")
        self.diffusion_apart = diffusion == "apart"
        super().__init__(model, dt, tolerance)
        self.problem = self._make_problem(preconditioner)
        space = self.problem.space
        self.newton = NewtonKrylov(
            space,
            _gmres(space, krylov_block),
            max_iterations=NEWTON_ITERATIONS,
            max_krylov=2 * KRYLOV_SIZE,
            forcing=FORCING,
        )
        self.counters |= {"newton_iterations": 0, "krylov_iterations": 0}
        self._units = self._unit_masses()
        self._allocate(self.model)

    def start(self, state: wp.array, t: float = 0.0) -> None:
        """Begin from a copy of the state at time t [s]."""
        if self.problem.preconditioner is not None:
            self.problem.preconditioner.load_state_dict({})
        self.newton.nonlinearity = 0.0 if self.model.scene.linear else None
        super().start(state, t)

    def costs(self) -> dict[str, float]:
        """Counts of the solver and its preconditioner, and seconds of the latter's set-up."""
        made = self.problem.preconditioner
        return super().costs() | ({} if made is None else made.costs())

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """Copies of all that a bitwise exact restart needs, a set-up in use included."""
        made = self.problem.preconditioner
        in_use = {} if made is None else made.state_dict()
        known = self.newton.nonlinearity
        learnt = {"nonlinearity": np.array(-1.0 if known is None else known)}
        return super().state_dict() | in_use | learnt

    def load_state_dict(self, state: dict[str, NDArray[Any]], steps: int) -> None:
        """Go on from what `state_dict` returned after that many steps."""
        super().load_state_dict(state, steps)
        known = float(state["nonlinearity"])
        self.newton.nonlinearity = known if known >= 0.0 else None
        if self.problem.preconditioner is not None:
            self.problem.preconditioner.load_state_dict(state)

    def error_estimate(self) -> float:
        """Norm [m s-1] of the error of the step last attempted, if `estimate_order` is not None."""
        raise NotImplementedError

    def _make_problem(self, preconditioner: str) -> Any:
        """What Newton solves, with its `space` and its `preconditioner`."""
        return StageProblem(self.model, self.space, preconditioner)

    def attempt(self, t: float, dt: float) -> str | None:
        """Write the state one step dt [s] after `state`, at t [s], to `new`; see there."""
        known = self.newton.nonlinearity
        failure = self.step_to(t, dt, self.new)
        fault = failure.message if failure else self._fault()
        if fault is not None:
            self.newton.nonlinearity = known
        return fault

    def step_to(self, t: float, dt: float, out: wp.array) -> Failure | None:
        """Write the state one step dt [s] after `state`, at t [s], to `out`.

        Returns the result of the solve that failed, if one did; nothing has changed then.
        """
        self.tolerance = self._goal(dt)
        return self._attempt(t, dt, out)

    @abstractmethod
    def _attempt(self, t: float, dt: float, out: wp.array) -> Failure | None:
        """As `step_to`, with the tolerance set."""

    def share_solver(self, other: "ImplicitStepper") -> None:
        """Solve with the preconditioner, the Krylov basis and the motion of another; it counts."""
        self.problem, self.newton, self.motion = other.problem, other.newton, other.motion
        self.counters = other.counters

    def tighten(self, tolerance: float) -> None:
        """Take this tolerance from now on."""
        self.loosest = tolerance

    def _solve(self, tau: float, t: float, rhs: wp.array, x: wp.array) -> NewtonResult:
        """Solve x - tau F(x, t) = rhs from the guess x."""
        self.problem.tau, self.problem.time, self.problem.rhs = tau, t, rhs
        result = self._newton_solve(tau, x, tau * self.motion.rate)
        self._restore_mass(rhs, x, self._mass_gain(tau, t))
        return result

    def _newton_solve(self, tau: float, x: wp.array, scale: float) -> NewtonResult:
        """Solve the problem as it is set from the guess x; the tolerance is relative to `scale`."""
        self._prepare(tau)
        self.newton.rtol = self.tolerance
        result = self.newton.solve(self.problem, x, scale, self._worthless())
        self.counters["newton_iterations"] += result.newton_iterations
        self.counters["krylov_iterations"] += result.krylov_iterations
        return result

    def _solve_linear(self, rhs: wp.array, x: wp.array, **goal: Any) -> LinearResult:
        """Solve the linearised problem as it is set from the guess x, to what `goal` says."""
        result = self.newton.gmres.solve(
            self.problem.jacobian,
            rhs,
            x,
            self.problem.precondition,
            **({"rtol": 0.0} | goal),
            max_iterations=self.newton.max_krylov,
        )
        self.counters["krylov_iterations"] += result.iterations
        return result

    def _prepare(self, tau: float) -> None:
        """Bring the preconditioner to the present state and tau [s]."""
        if self.problem.preconditioner is not None:
            point = self.model.point_of_tangent(self.state)
            self.problem.preconditioner.update(point, self.prepared_for or tau)

    def _worthless(self) -> float:
        """Residual that is worth one iteration, not two; there is none if the tolerance is 0."""
        least = WORTHLESS * self.space.epsilon * self.space.norm(self.state)
        return least if self.loosest > 0.0 else 0.0

    def _mass_gain(self, tau: float, t: float) -> float:
        """Mean depth [m] that a solution of x - tau F(x, t) = rhs has more than rhs."""
        return tau * self.model.mean_source(t)

    def _restore_mass(self, rhs: wp.array, x: wp.array, gain: float = 0.0) -> None:
        """Give x the masses of the exact solution: those of the right-hand side, and a gain [m].

        Only masses that all effects conserve; what forcing brings has no tracer in it.
        """
        space = self.space
        for conserved, unit, square in self._units:
            there, here = space.dots((rhs, unit), (x, unit))
            more = gain if conserved == "mass" else 0.0
            space.axpy(float(there - here) / square + more, unit, x)

    def _unit_masses(self) -> list[tuple[str, wp.array, float]]:
        """What is conserved, with states that are zero but for 1 m of depth, or of a tracer.

        And the square of their norm.
        """
        model = self.model
        kept = MASSES.intersection(*(effect.conserves for effect in model.scene.effects))
        blocks = np.kron(np.eye(len(model.names)), np.ones(model.mesh.size))
        named = [("mass" if name == "h" else "tracers", name) for name in model.names]
        units = [
            (mass, model.device_mesh.scatter(block))
            for (mass, name), block in zip(named, blocks, strict=True)
            if name not in ("u", "v") and mass in kept
        ]
        return [(mass, unit, self.space.dot(unit, unit)) for mass, unit in units]

    def _slope(self, x: wp.array, rhs: wp.array, tau: float, out: wp.array) -> None:
        """out = (x - rhs)/tau: F(x) as the solved stage equation implies it, mass included."""
        self.space.copy(x, out)
        self.space.axpby(-1.0 / tau, rhs, 1.0 / tau, out)


def _gmres(space: VectorSpace, block: int) -> FlexibleGMRES:
    """GMRES with as large a basis as memory allows: it pays at large advective Courant numbers.

    The same on any number of ranks, so that they agree when to begin again.
    """
    fits = int(KRYLOV_MEMORY / (2 * 8 * space.whole))
    return FlexibleGMRES(space, max(20, min(KRYLOV_SIZE, fits)), block)
