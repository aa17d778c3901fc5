"""The linear gravity waves that semi-implicit steppers treat implicitly.

L(V, h) = (-g G h [- f k x V], -D(H V)): waves about rest under a level surface, H deep above the
bottom, with the model's own discrete, DSS'd gradient and divergence, so that F - L keeps mass as F
does.  With D and G adjoint, S = I - tau^2 g D H G is symmetric for the areas as weights.
"""

import time
from dataclasses import replace

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.equations.effects import EFFECTS
from swe_sphere.equations.model import Model
from swe_sphere.equations.right_hand_side import Operator
from swe_sphere.equations.spectrum import Spectrum, estimate_spectrum
from swe_sphere.errors import ConfigError
from swe_sphere.kernels import Terms
from swe_sphere.kernels.pointwise import Pointwise
from swe_sphere.operators import TendencyOperator
from swe_sphere.operators.replay import recorded
from swe_sphere.solvers.conjugate_gradients import ConjugateGradients
from swe_sphere.solvers.gmres import FlexibleGMRES
from swe_sphere.solvers.linear_result import KrylovSolver, LinearResult
from swe_sphere.solvers.preconditioners.multilevel import Multilevel, schur_operator
from swe_sphere.solvers.tracer_waves import TracerWaves
from swe_sphere.solvers.vector_space import VectorSpace

CORIOLIS = ("explicit", "implicit")
"""Where the Coriolis force may be taken."""
DEEPEST = 0.8
"""Least reference depth, as a part of that below the highest surface.  Where fluid is deeper than
its reference, explicit waves grow sooner than where it is shallower (docs/imex_steps.md)."""
INERTIAL = 1.25
"""How much more explicit inertial waves limit steps than advection of the same frequency: by
measurement on meshes so coarse that they do (docs/imex_steps.md)."""
MOST_ITERATIONS = 200
BASIS = 40


def reference_depth(model: Model) -> Array:
    """Depth (N,) below the mean surface of the initial state [m], or 0.8 of that below the highest.

    The larger of both.  Of linearised dynamics it is that of the base.
    """
    flow = model.scene.base or model.scene.initial
    _, _, depth = flow(model.mesh.lon, model.mesh.lat)
    surface: Array = depth + model.bottom
    mean = np.average(surface, weights=model.mesh.area)
    deep: Array = np.maximum(mean - model.bottom, DEEPEST * (surface.max() - model.bottom))
    return deep


class GravityWaves:
    """L on the device, with or without the Coriolis force (`coriolis` "implicit" or "explicit").

    Raises ConfigError for a scene without gravity waves, and for an unknown `coriolis`.
    """

    def __init__(self, model: Model, coriolis: str = "explicit") -> None:
        if coriolis not in CORIOLIS:
            raise ConfigError(f"coriolis is explicit or implicit, not {coriolis!r}")
        if not any(effect.name == "pressure-gradient" for effect in model.scene.effects):
            raise ConfigError(
                f"scene {model.scene.name} has no gravity waves to treat implicitly: "
                "choose an explicit stepper"
            )
        self.model, self.depth = model, reference_depth(model)
        turning = coriolis == "implicit" and model.scene.coriolis is not None
        self.coriolis = model.coriolis if turning else np.zeros(model.mesh.size)
        n, scatter = model.mesh.size, model.device_mesh.scatter
        parameters = {
            "gravity": model.scene.planet.gravity,
            "base": scatter(np.concatenate([np.zeros(2 * n), self.depth])),
            "coriolis": scatter(self.coriolis),
        }
        operator = TendencyOperator(
            model.device_mesh, Terms(pressure=True, tangent=True), model.launch, parameters,
            Pointwise(rotation=turning),
        )  # fmt: skip
        self.apply_to_fluid = recorded(model.launch, operator)
        """out = L d for wind and depth: apply_to_fluid(d, out)."""
        self.tracers: TracerWaves | None = None
        if model.tracers is not None:
            self.tracers = TracerWaves(model, model.tracers, parameters["base"])

    @property
    def symmetric(self) -> bool:
        """Whether S is: without the Coriolis force."""
        return not self.coriolis.any()

    def linearise(self, state: wp.array) -> None:
        """Fix the mixing ratios with which tracers follow the waves; nothing to do without any."""
        if self.tracers is not None:
            self.tracers.linearise(state)

    def apply(self, d: wp.array, out: wp.array) -> None:
        """out = L d, both states."""
        self.apply_to_fluid(d, out)
        if self.tracers is not None:
            self.tracers.apply(d, out)

    def explicit_spectrum(self, state: wp.array, t: float = 0.0) -> Spectrum:
        """Spectral radii [s-1] of what limits explicit steps of F - L, and of dissipation.

        That is the advection, and where it is slow the Coriolis force.  F - L has larger
        eigenvalues, of both in one place, but as the gravity waves are implicit those do not grow
        (docs/imex_steps.md).  With effects of a user's own all of F - L counts.
        """
        model = self.model
        dissipation = model.fluid_dissipation if model.dissipative else None
        found = estimate_spectrum(model, state, _advection(model, state, t), dissipation)
        wave = max(found.wave, INERTIAL * float(np.abs(model.coriolis).max()))
        if any(effect.name not in EFFECTS for effect in model.scene.effects):
            wave = max(wave, estimate_spectrum(model, state, self._rest(t)).wave)
        return replace(found, wave=wave)

    def _rest(self, t: float) -> Operator:
        """F - L of wind and depth."""
        model, ones = self.model, np.ones(self.model.fluid_size)
        linear = model.device_mesh.upload(ones)
        space = VectorSpace(ones, model.device, model.device_mesh.real)

        def rest(x: wp.array, out: wp.array) -> None:
            model.fluid_tendency(x, t, out)
            self.apply_to_fluid(x, linear)
            space.axpy(-1.0, linear, out)

        return rest


def advection_rate(model: Model, state: wp.array, t: float = 0.0) -> float:
    """Spectral radius [s-1] of the advection of depth by the wind of a state, -div(V h)."""
    return estimate_spectrum(model, state, _advection(model, state, t)).wave


def _advection(model: Model, state: wp.array, t: float) -> Operator:
    winds = 2 * model.device_mesh.size
    wind = wp.clone(state[:winds])

    def advection(x: wp.array, out: wp.array) -> None:
        wp.copy(x, wind, count=winds)
        model.fluid_tendency(x, t, out)
        out[:winds].zero_()

    return advection


class GravityWaveSolver:
    """(I - tau L)^-1 to a tolerance, by block elimination and conjugate gradients on S.

    With the Coriolis force in L, S is not symmetric and flexible GMRES takes over.  S is applied in
    float64 and preconditioned in float32, whatever the run's number type.
    """

    def __init__(self, waves: GravityWaves) -> None:
        self.waves, self.tau = waves, 0.0
        model = waves.model
        outer = model.device_mesh.real
        self.operator = schur_operator(model, waves.coriolis, wp.float64, outer)
        self._rough = schur_operator(model, waves.coriolis, wp.float32, outer)
        self._inner = Multilevel(self._rough, symmetric=waves.symmetric)
        self._rough_fields = self._rough.field(), self._rough.field()
        area = model.mesh.area / model.mesh.area.sum()
        self.space = VectorSpace(area, real=wp.float64, mesh=model.device_mesh)
        self.setups, self.setup_seconds = 0, 0.0
        self._krylov: KrylovSolver = (
            ConjugateGradients(self.space) if waves.symmetric else FlexibleGMRES(self.space, BASIS)
        )
        self._fields = self.operator.field(), self.operator.field()
        self._b, self._h = self.space.zeros(), self.space.zeros()
        self._ones = wp.full_like(self._b, 1.0)

    def setup(self, tau: float) -> None:
        """Prepare for the implicit step tau [s]; nothing to do if it is the last one."""
        if tau == self.tau:
            return
        start = time.perf_counter()
        self.tau = tau = float(tau)  # a numpy.float64 would make float32 arrays float64
        depth = self.waves.depth
        self.operator.configure(tau, depth, self._inner.prepare(tau, depth))
        launch = self.operator.launch
        self._apply = recorded(launch, self._product)
        self._precondition = recorded(launch, self._inverse)
        self.setups += 1
        self.setup_seconds += time.perf_counter() - start

    def solve(self, r: wp.array, guess: wp.array, out: wp.array, tolerance: float) -> LinearResult:
        """out = (I - tau L)^-1 r, both states, from a guess (N,) of the depth.

        tolerance: of the residual of the eliminated system, relative to its right-hand side.  The
        masses of `out` are those of r, whatever the tolerance.  All are of the run's number
        type.
        """
        b, h = self._fields
        self.operator.eliminate(r, b)
        self.operator.collect(b, self._b)
        self.operator.spread(guess, h)
        self.operator.collect(h, self._h)
        result = self._krylov.solve(
            self._apply, self._b, self._h, self._precondition, tolerance,
            max_iterations=MOST_ITERATIONS,
        )  # fmt: skip
        self.space.match_mean(self._b, self._h, self._ones)
        self.operator.spread(self._h, h)
        self.operator.substitute(r, h, out)
        if self.waves.tracers is not None:
            self.waves.tracers.solve(self.tau, r, out)
        return result

    def _product(self, d: wp.array, out: wp.array) -> None:
        field, image = self._fields
        self.operator.spread(d, field)
        self.operator.apply(field, image)
        self.operator.collect(image, out)

    def _inverse(self, r: wp.array, z: wp.array) -> None:
        rough_r, rough_z = self._rough_fields
        self._rough.spread(r, rough_r)
        self._inner.solve(rough_r, rough_z)
        self._rough.collect(rough_z, z)
