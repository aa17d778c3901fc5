"""The average-vector-field method, which conserves energy exactly."""

import warp as wp

from swe_sphere.equations.energy_conserving import PoissonTendency
from swe_sphere.equations.model import Model
from swe_sphere.solvers.vector_space import VectorSpace
from swe_sphere.steppers.implicit import ImplicitStepper, StageProblem


class AverageProblem(StageProblem):
    """x - dt G(start, x) = start, with G the average of the right-hand side between two states.

    dt is twice `tau`, and `rhs` is the start. The Jacobian is approximated by I - dt/2 J(mean),
    which differs by terms of second order in the step's change: Newton then converges linearly by a
    large factor per iteration and needs no special code.
    """

    slopes = 2.0

    def __init__(self, model: Model, space: VectorSpace, preconditioner: str) -> None:
        super().__init__(model, space, preconditioner)
        self._average = PoissonTendency(model) if PoissonTendency.fits(model) else None
        self._mean, self._loss = model.zeros(), model.zeros()

    def linearise(self, x: wp.array) -> None:
        self._operator.update(self._mean_of(x), self.time)

    def _evaluate(self, x: wp.array) -> None:
        if self._average is None:
            self._model.tendency(self._mean_of(x), self.time, self._slope)
            return
        self._average(self.rhs, x, self.time, self._slope)
        if self._model.dissipative:
            self._model.dissipative_tendency(self._mean_of(x), self._loss)
            self.space.axpy(1.0, self._loss, self._slope)

    def _mean_of(self, x: wp.array) -> wp.array:
        self.space.axpby(0.5, x, 0.5, self.rhs, self._mean)
        return self._mean


class AverageVectorField(ImplicitStepper):
    """Average vector field: second order, keeps the energy to the solver's tolerance.

    x_new = x + dt S(mean) (average gradient of the energy between the two), S skew (Celledoni et
    al. 2012, doi:10.1016/j.jcp.2012.06.022; see `PoissonTendency`). Forcing, dissipation, and a
    scene without the full dynamics, which has no such energy, use the midpoint rule.
    """

    name, order = "average-vector-field", 2
    style = ("#6E3548", "8")
    default_tolerance = 1e-6
    error_constant = 1.0 / 12.0  # the midpoint rule's
    equations = AverageProblem
    memory = "state", "slope"  # slope of the last step

    def allocate(self) -> None:
        self.slope = self.model.zeros()
        self.guesses = (self.slope,)

    def solve_step(self, t: float, dt: float, out: wp.array) -> str | None:
        self.space.axpby(dt, self.slope, 1.0, self.state, out)
        return self.solver.solve(0.5 * dt, t + 0.5 * dt, self.state, out)

    def accept(self, dt: float) -> None:
        self.implied_slope(self.new, self.state, dt, self.slope)
        super().accept(dt)
