"""The average-vector-field method, which conserves energy exactly."""

import warp as wp

from swe_sphere.equations.effects import PointwiseEffect
from swe_sphere.equations.model import Model
from swe_sphere.kernels import Terms
from swe_sphere.kernels.average import average_kernel
from swe_sphere.kernels.pointwise import Pointwise
from swe_sphere.operators import TendencyOperator
from swe_sphere.operators.replay import recorded
from swe_sphere.solvers.vector_space import VectorSpace
from swe_sphere.steppers.implicit import ImplicitStepper, StageProblem

NEEDED = ("momentum-advection", "pressure-gradient")


class PoissonTendency:
    """Average tendency between two states; its product with the energy's mean gradient is zero.

    d(V, h)/dt = (-q k x F - grad B, -div F), with F and B the averages of hV and |V|²/2 + g(h + b)
    between the states and the potential vorticity q = (curl V + f)/h half way (Wimmer, Cotter &
    Bauer 2020, doi:10.1016/j.jcp.2019.109016). The operator is skew for the quadrature of the mesh,
    because F is continuous and integration by parts is exact there. F carries the tracers: constant
    mixing ratios stay constant. The tendency excludes dissipation. `fits` must accept the model.
    """

    def __init__(self, model: Model) -> None:
        self._model, mesh, scene = model, model.device_mesh, model.scene
        self._mean, self._base = model.zeros(), model.zeros()
        terms = Terms(advection=True, pressure=True, skew=True)
        rotation, orography = map(scene.effect, ("rotation", "orography"))
        point = Pointwise(rotation=rotation is not None, forcing=scene.forcing is not None)
        own = model.parameters | {"base": self._base}
        self._operator = recorded(model.launch, TendencyOperator(mesh, terms, own, point))
        (self._average,) = model.launch.compile(mesh.real, average_kernel(orography is not None))
        bottom = model.parameters.get("bottom", self._mean)
        self._constants = mesh.size, scene.planet.gravity, bottom
        self._masses = self._mean[model.fluid_size :] if model.tracers is not None else None

    @staticmethod
    def fits(model: Model) -> bool:
        """Return whether the scene has the energy that this form conserves."""
        others = [e for e in model.scene.effects if isinstance(e, PointwiseEffect)]
        if model.scene.base is not None or not all(e.dissipation for e in others):
            return False
        return all(model.scene.effect(name) is not None for name in NEEDED)

    def __call__(self, first: wp.array, last: wp.array, t: float, out: wp.array) -> None:
        """Set out to the average tendency between two states, with the forcing of the time t [s].

        The call counts as one right-hand side.
        """
        model, nodes = self._model, self._model.device_mesh.size
        model.set_time(t)
        model.counters["rhs_evaluations"] += 1
        model.launch(self._average, nodes, *self._constants, first, last, self._mean, self._base)
        self._operator(self._mean, out)
        if (tracers := model.tracers) is not None:
            first, last = first[tracers.first :], last[tracers.first :]
            model.launch.combine(last, last, -0.5, first, 0.5, out=self._masses)
            tracers.transport(self._base, self._mean, out)


class AverageProblem(StageProblem):
    """x - dt G(start, x) = start, with G the average of the right-hand side between two states.

    dt is twice `tau`, and `rhs` is the start. The Jacobian is approximated by I - dt/2 J(mean),
    which differs by terms of second order in dt: Newton then converges linearly by a
    large factor per iteration and needs no special code.
    """

    tau_factor = 2.0

    def __init__(self, model: Model, space: VectorSpace, preconditioner: str) -> None:
        super().__init__(model, space, preconditioner)
        self._average = PoissonTendency(model) if PoissonTendency.fits(model) else None
        self._mean, self._loss = model.zeros(), model.zeros()

    def linearise(self, x: wp.array) -> None:
        super().linearise(self._mean_of(x))

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
    default_tolerance, splits_penalty = 1e-6, True
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
