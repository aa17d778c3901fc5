"""The linear gravity waves that semi-implicit steppers treat implicitly.

L(V, h) = (-g G h, -D(H V)): waves about rest under a level surface, H deep above the bottom, with
the model's own discrete gradient and divergence after DSS, so that F - L conserves mass as F does.
D and G are adjoint: S = I - tau^2 g D H G is symmetric if weighted by areas. Coriolis is explicit.
"""

import time
from collections.abc import Callable
from functools import partial

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.equations.effects import EFFECTS
from swe_sphere.equations.model import Model
from swe_sphere.equations.right_hand_side import Operator
from swe_sphere.equations.spectrum import SpectralRadii, spectral_radius
from swe_sphere.equations.tracer_equations import MassFlux, TracerEquations
from swe_sphere.errors import ConfigError
from swe_sphere.kernels import Terms
from swe_sphere.kernels.tracers import mass_flux
from swe_sphere.operators import TendencyOperator
from swe_sphere.operators.device_mesh import Field
from swe_sphere.operators.replay import recorded
from swe_sphere.operators.schur import SchurOperator
from swe_sphere.operators.tracers import TracerTransport
from swe_sphere.solvers.krylov import ConjugateGradients, LinearResult
from swe_sphere.solvers.preconditioners.multilevel import Multilevel, schur_operator
from swe_sphere.solvers.vector_space import Masses, VectorSpace

LEAST_DEPTH_SHARE = 0.8
"""Least reference depth, as a fraction of the depth below the highest surface.  Explicit waves grow
sooner in fluid deeper than its reference than in shallower fluid (docs/results/steps.md)."""
ROUGH = 2e-6
"""Products with S in float32, at half the cost, suffice for relative tolerances above ROUGH times
the largest diagonal entry of S: their error relative to the factor is at most a twentieth of it.
So do elimination and substitution, whose error is relative to the state they are applied to."""
INERTIAL = 1.25
"""An inertial wave of frequency f limits explicit steps like advection of the rate INERTIAL f;
measured on meshes coarse enough that such waves limit the step (docs/results/steps.md)."""


def reference_depth(model: Model) -> Array:
    """Return the reference depth H (N,) [m] of the implicit gravity waves.

    It is the larger of the depth below the mean initial surface and 0.8 of the depth below the
    highest, but at most the largest initial depth. Raises ConfigError without gravity waves.
    """
    if model.scene.effect("pressure-gradient") is None:
        raise ConfigError(
            f"scene {model.scene.name} has no gravity waves to treat implicitly: "
            "choose an explicit stepper"
        )
    _, _, depth = (model.scene.base or model.scene.initial)(model.mesh.lon, model.mesh.lat)
    bottom = model.bottom if model.scene.effect("orography") else np.zeros_like(depth)
    surface: Array = depth + bottom
    mean = np.average(surface, weights=model.mesh.area)
    deep: Array = np.maximum(mean - bottom, LEAST_DEPTH_SHARE * (surface.max() - bottom))
    return deep.clip(max=depth.max())


def state_of_rest(model: Model) -> wp.array:
    """Return a fluid (3N,) at rest with the reference depth."""
    return model.device_mesh.scatter(np.pad(reference_depth(model), (2 * model.mesh.size, 0)))


def wave_operator(model: Model, rest: wp.array) -> Operator:
    """Return L for wind and depth about a state of rest: out = L d from (d, out)."""
    terms = Terms(pressure=True, tangent=True)
    parameters = {"gravity": model.scene.planet.gravity, "base": rest}
    return recorded(model.launch, TendencyOperator(model.device_mesh, terms, parameters))


def explicit_radii(model: Model, state: wp.array, t: float = 0.0) -> SpectralRadii:
    """Return the spectral radii [s-1] that limit explicit steps of F - L, and of dissipation.

    The larger of the rates of advection and of the Coriolis force counts. F - L has larger
    eigenvalues, but with implicit gravity waves these modes do not grow (docs/results/steps.md).
    With custom effects all of F - L counts.
    """
    wave = max(advection_rate(model, state, t), INERTIAL * float(np.abs(model.coriolis).max()))
    if any(effect.name not in EFFECTS for effect in model.scene.effects):
        linear, image = wave_operator(model, state_of_rest(model)), model.zeros(model.fluid_size)
        tendency = model.right_hand_side("conservative", fluid_only=True, counted=False)

        def remainder(x: wp.array, out: wp.array) -> None:
            """Set out = (F - L) x for wind and depth."""
            tendency(x, t, out)
            linear(x, image)
            model.launch.combine(out, image, -1.0, out=out)

        wave = max(wave, spectral_radius(model, state, remainder))
    return SpectralRadii(wave, model.dissipation_radius(state))


def advection_rate(model: Model, state: wp.array, t: float = 0.0) -> float:
    """Return the spectral radius [s-1] of the advection of depth by a state's wind, -div(V h)."""
    winds = 2 * model.device_mesh.size
    wind = wp.clone(state[:winds])
    tendency = model.right_hand_side("conservative", fluid_only=True, counted=False)

    def advection(x: wp.array, out: wp.array) -> None:
        wp.copy(x, wind, count=winds)
        tendency(x, t, out)
        out[:winds].zero_()

    return spectral_radius(model, state, advection)


class TracerWaves:
    """L_hq(V) = -div(q H V), the tracers' rows of L, with the mixing ratios q of one state.

    Nothing depends on tracers, so that (I - tau L)^-1 needs no solve for them; but they must follow
    the depth: if its waves were implicit and those of hq explicit, a constant q would not stay
    constant. The solver's residual of the depth, times q, is added to the tracers.
    """

    def __init__(self, model: Model, tracers: TracerEquations, rest: wp.array) -> None:
        """Store `rest`, wind and depth without motion, with the reference depth H [m]."""
        mesh, count, n = model.device_mesh, tracers.count, model.device_mesh.size
        self._rest, self._depth, self._first = rest, tracers.depth, tracers.first
        self._launch, (self._mass_flux,) = model.launch, model.launch.compile(mesh.real, mass_flux)
        self._flow = mesh.upload(np.zeros(2 * n))
        self._ratio = tracers.mixing_ratio()
        self._transport = TracerTransport(mesh, count)
        self._depth_transport = TracerTransport(mesh, 1)
        self._rates, self._depth_rate = mesh.upload(np.zeros(count * n)), mesh.upload(np.zeros(n))
        self._ones, self._off = mesh.upload(np.ones(n)), mesh.stage
        self._masses, self._blocks = Masses(mesh), range(self._first // n, len(model.names))

    def linearise(self, state: wp.array) -> None:
        """Store the mixing ratios of a state."""
        self._ratio.set(state)

    def apply(self, d: wp.array, out: wp.array) -> None:
        """Set out_hq = L_hq d."""
        self._carry_rest(d)
        self._transport(self._flow, self._ratio.values, 0, out, self._first)

    def solve(self, tau: float, r: wp.array, x: wp.array) -> None:
        """Set x_hq = r_hq + tau L_hq x + q (residual of x_h), with the mass of r_hq."""
        self._carry_rest(x)
        self._transport(self._flow, self._ratio.values, 0, self._rates, 0)
        self._depth_transport(self._flow, self._ones, 0, self._depth_rate, 0)
        self._ratio.correct(self._rates, self._depth_rate, tau, r, x)
        for block in self._blocks:
            self._masses.restore(r, x, block)

    def _carry_rest(self, d: wp.array) -> None:
        """Set flow = H V."""
        n = self._ones.size
        self._launch(self._mass_flux, n, d, self._rest, self._depth, n, 0, self._off, self._flow)


class FluxWaves:
    """L_G(V) = H V: the mass flux of the waves at a point, in place of tracers."""

    def __init__(self, model: Model, flux: MassFlux, rest: wp.array) -> None:
        """Store `rest`, wind and depth without motion, with the reference depth H [m]."""
        self._launch, self._flux, self._rest = model.launch, flux, rest

    def apply(self, d: wp.array, out: wp.array) -> None:
        """Set out_G = L_G d."""
        self._flux.transport(d, self._rest, out)

    def solve(self, tau: float, r: wp.array, x: wp.array) -> None:
        """Set x_G = r_G + tau L_G x."""
        self.apply(x, x)
        old, crossed = (each[self._flux.first :] for each in (r, x))
        self._launch.combine(old, crossed, tau, out=crossed)


class GravityWaves:
    """L on the device, and (I - tau L)^-1 by block elimination and conjugate gradients on S.

    For any number type of the run, vectors are float64 and the preconditioner is float32, and so
    are elimination, products with S and substitution where the tolerance permits (`ROUGH`).  Raises
    ConfigError for a scene without gravity waves.
    """

    def __init__(self, model: Model) -> None:
        self.depth, mesh, rest = reference_depth(model), model.device_mesh, state_of_rest(model)
        self._apply_to_fluid = wave_operator(model, rest)
        self._carried: TracerWaves | FluxWaves | None = None
        if isinstance(model.carried, MassFlux):
            self._carried = FluxWaves(model, model.carried, rest)
        elif model.carried is not None:
            self._carried = TracerWaves(model, model.carried, rest)
        coriolis = np.zeros(model.mesh.size)
        self.operator = schur_operator(model, coriolis, wp.float64, mesh.real)
        self._rough = schur_operator(model, coriolis, wp.float32, mesh.real)
        self._inner = Multilevel(self._rough, smooths_first=True)
        self._fields = self.operator.field(), self.operator.field()
        self._rough_fields = self._rough.field(), self._rough.field()
        area = model.mesh.area / model.mesh.area.sum()
        self.space = VectorSpace(area, real=wp.float64, mesh=mesh)
        self._krylov = ConjugateGradients(self.space)
        self._b, self._h = self.space.zeros(), self.space.zeros()
        self._ones = wp.full_like(self._b, 1.0)
        self._depth_rows = slice(2 * mesh.size, 3 * mesh.size)
        self.tau, self._counters = 0.0, model.counters
        self._counters |= {"setups": 0, "setup_seconds": 0.0}

    def linearise(self, state: wp.array) -> None:
        """Fix the mixing ratios with which tracers follow the waves."""
        if isinstance(self._carried, TracerWaves):
            self._carried.linearise(state)

    def apply(self, d: wp.array, out: wp.array) -> None:
        """Set out = L d, both states."""
        self._apply_to_fluid(d, out)
        if self._carried is not None:
            self._carried.apply(d, out)

    def setup(self, tau: float) -> None:
        """Prepare for the implicit step tau [s]; no work if it equals the last one."""
        if tau == self.tau:
            return
        start = time.perf_counter()
        self.tau = tau = float(tau)  # a numpy.float64 would make float32 arrays float64
        for operator in (self.operator, self._rough):
            operator.configure(tau, self.depth)
        self._inner.setup(tau, self.depth)
        self._exact = self._parts(self.operator, *self._fields)
        self._in_float32 = self._parts(self._rough, *self._rough_fields)
        inner = partial(_on_fields, self._rough, *self._rough_fields, self._inner.solve)
        self._precondition = recorded(self._rough.mesh.launch, inner)
        self._least_rough = ROUGH * float(self.operator.diagonal.max())
        self._counters["setups"] += 1
        self._counters["setup_seconds"] += time.perf_counter() - start

    def solve(
        self, r: wp.array, guess: wp.array | None, out: wp.array, tolerance: float,
        target: float = 0.0,
    ) -> LinearResult:  # fmt: skip
        """Set out = (I - tau L)^-1 r, both states, from a guess (N,) of the depth; None for 0.

        The residual of the eliminated system is at most `target` [m] or `tolerance` times its
        right-hand side; `out` has exactly the masses of r. Arrays have the run's number type.
        """
        for parts in (self._in_float32, self._exact):
            eliminate, product, substitute = parts
            eliminate(r, self._b)
            size = self.space.norm(self._b)
            rtol = max(tolerance, target / (size or 1.0))
            if rtol > self._least_rough:
                break
        if guess is not None:
            self.space.copy(guess, self._h)
        system = product, self._b, self._h, self._precondition
        result = self._krylov.solve(*system, rtol, scale=size, guess=guess is not None)
        self.space.match_mean(self.space.converted(r[self._depth_rows]), self._h, self._ones)
        substitute(r, out)
        if out.dtype is self._h.dtype:
            wp.copy(out, self._h, dest_offset=self._depth_rows.start)  # not rounded to float32
        if self._carried is not None:
            self._carried.solve(self.tau, r, out)
        return result

    def _parts(
        self, of: SchurOperator, field: Field, image: Field
    ) -> list[Callable[[wp.array, wp.array], None]]:
        """Return elimination (r, b), the product with S and substitution (r, out), recorded."""

        def eliminate(r: wp.array, b: wp.array) -> None:
            of.eliminate(r, field)
            of.to_nodes(field, b)

        def substitute(r: wp.array, out: wp.array) -> None:
            of.to_field(self._h, field)
            of.substitute(r, field, out)

        product = partial(_on_fields, of, field, image, of.apply)
        return [recorded(of.mesh.launch, part) for part in (eliminate, product, substitute)]


def _on_fields(
    of: SchurOperator, field: Field, image: Field, function: Callable[[Field, Field], None],
    x: wp.array, out: wp.array,
) -> None:  # fmt: skip
    """Set out to a function of x, both nodal vectors (N,), by two fields."""
    of.to_field(x, field)
    function(field, image)
    of.to_nodes(image, out)
