"""Leapfrog with the Robert-Asselin-Williams filter, explicit and semi-implicit."""

from typing import Any, ClassVar

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.equations.effects import as_float
from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError
from swe_sphere.kernels.vectors import leapfrog
from swe_sphere.steppers.imex_runge_kutta import ARK2, ImexStepper
from swe_sphere.steppers.runge_kutta import RK4
from swe_sphere.steppers.split_diffusion import Diffusion
from swe_sphere.steppers.stability import Complex, largest_moduli
from swe_sphere.steppers.stepper import Stepper


class Leapfrog(Stepper):
    """Leapfrog with Robert-Asselin-Williams filter: one right-hand side a step, started by rk4.

    Williams 2009 (doi:10.1175/2009MWR2724.1). Drag and relaxation are evaluated at the past level,
    where they are stable; diffusion acts over the two steps from there. Other filters (strength 0:
    none) serve for comparison with other models: `stable_dt` assumes the default.
    """

    name, order = "leapfrog", 2
    levels = "state", "previous"
    memory: ClassVar[tuple[str, ...]] = levels
    diffusion_steps = 2
    holds_damping = True
    repeats_from, fused_steps = 1, 8
    reach = 2.0

    default_strength: ClassVar[float] = 0.1
    """Strength nu of the filter (Robert's coefficient 0.05 in other notation)."""
    default_share: ClassVar[float] = 0.7
    """Williams' alpha: share of the displacement of the present level (1: Robert-Asselin)."""

    def __init__(
        self, model: Model, dt: float, strength: float | None = None, share: float | None = None
    ) -> None:
        super().__init__(model, dt)
        self._set_filter(strength, share)
        self.previous, self._slope, self._part = (model.zeros() for _ in range(3))
        self._starter = self._make_starter(model.unpenalised())
        (self._kernel,) = model.launch.compile(model.device_mesh.real, leapfrog)

    def _set_filter(self, strength: float | None, share: float | None) -> None:
        """Set strength and share of the filter; ConfigError unless both are from 0 to 1."""
        strength = as_float(self.default_strength if strength is None else strength)
        share = as_float(self.default_share if share is None else share)
        if not (0.0 <= strength <= 1.0 and 0.0 <= share <= 1.0):
            raise ConfigError(
                f"{self.name}: strength and share of the filter must be from 0 to 1, got"
                f" {strength:g} and {share:g}"
            )
        self._filter = 0.5 * strength, share

    def _make_starter(self, model: Model) -> Stepper:
        """Build the stepper that takes the first step."""
        return RK4(model, self.dt)

    def advance(self) -> None:
        """Take a step from the past level; the first one by the other stepper."""
        if self.steps == 0:
            wp.copy(self.previous, self.state)
            self._starter.start(self.state, self.time)
            self._starter.step()
            wp.copy(self.state, self._starter.state)
            return
        model, slope = self.model, self._slope
        model.conservative_tendency(self.state, self.time, slope)
        if model.dissipative:
            model.dissipative_tendency(self.previous, self._part)
            model.launch.combine(slope, self._part, 1.0, out=slope)
        if self.diffusion is not None:
            self._diffuse(self.diffusion)
        inputs = self.previous, self.state, *self._next(), *self._filter
        model.device_mesh.launch_over_fields(self._kernel, model.size, *inputs)

    def _diffuse(self, diffusion: Diffusion) -> None:
        """Add to the slope the diffusion of the state that moves with it from the past level."""
        diffusion.join(self.previous, self._slope)

    def _next(self) -> tuple[wp.array, float, float, float]:
        """Return an array k, and the factors of x-, x and k in the unfiltered next level x+."""
        return self._slope, 1.0, 0.0, 2.0 * self.dt

    @classmethod
    def order_in(cls, model: Model, **options: Any) -> int:
        strength = options.get("strength")
        filtered = cls.default_strength if strength is None else strength
        return 1 if filtered else super().order_in(model, **options)

    @classmethod
    def amplification(cls, z_wave: Complex, z_dissipation: Complex) -> Array:
        return filtered_factor(1.0 + 2.0 * z_dissipation, 2.0 * z_wave)


class SemiImplicit(ImexStepper, Leapfrog):
    """Semi-implicit leapfrog, Robert-Asselin-Williams filter: one right-hand side and one solve.

    (I - dt L) x+ = x- + 2 dt [F(x) - L x] + dt L x- (Robert 1969; Hoskins & Simmons 1975,
    doi:10.1002/qj.49710142918), solved for half the second difference y = (x+ - 2 x + x-)/2 from
    the guess 0: (I - dt L) y = x- - x + dt F(x). Only diffusion, in F(x), needs L. ARK2 starts.
    """

    name = "semi-implicit"
    default_tolerance = 3e-2
    error_constant = 1.0 / 6.0  # leapfrog's, dt^3/3 of the third derivative, of a change of 2 dt

    def __init__(
        self, model: Model, dt: float, tolerance: float | None = None,
        strength: float | None = None, share: float | None = None,
    ) -> None:  # fmt: skip
        super().__init__(model, dt, tolerance)
        self._set_filter(strength, share)

    def allocate(self) -> None:
        self._change, self._rhs = self.model.zeros(), self.model.zeros()

    def _make_starter(self, model: Model) -> Stepper:
        return ARK2(model, self.dt, solver=self.solver)

    def advance(self) -> None:
        self.solver.waves.linearise(self.state)
        super().advance()
        if self.steps > 0:
            self.solver.accept(self.previous, self.state, self.dt)

    def _diffuse(self, diffusion: Diffusion) -> None:
        self.space.axpby(-1.0, self.state, 1.0, self.previous, self._rhs)
        self.solver.waves.apply(self._rhs, self._part)
        self.space.axpy(1.0, self._part, self._slope)  # of the implicit step: F(x) + L (x- - x)
        super()._diffuse(diffusion)
        self.space.axpy(-1.0, self._part, self._slope)

    def _next(self) -> tuple[wp.array, float, float, float]:
        dt, solver, state = self.dt, self.solver, self.state
        solver.aim(state, self.error_constant, self.order, dt)
        self.model.launch.combine(self.previous, state, -1.0, self._slope, dt, out=self._rhs)
        solver.solve(dt, self.time, self._rhs, None, self._change, dt * solver.rate)
        return self._change, -1.0, 2.0, 2.0

    @classmethod
    def split_factor(cls, z_implicit: Complex, z_wave: Complex, z_dissipation: Complex) -> Array:
        old = (1.0 + z_implicit + 2.0 * z_dissipation) / (1.0 - z_implicit)
        return filtered_factor(old, 2.0 * z_wave / (1.0 - z_implicit))


def filtered_factor(old: Complex, new: Complex) -> Array:
    """Return the largest amplification by the scheme x+ = old x- + new x with the filter.

    Its levels are rows of weights of (x-, x), which a step with the filter's displacement D =
    strength / 2 (x- - 2 x + x+) maps to (x + share D, x+ - (1 - share) D).
    """
    half, share = 0.5 * Leapfrog.default_strength, Leapfrog.default_share
    past, present = np.eye(2)
    future = np.stack(np.broadcast_arrays(old, new), axis=-1)
    moved = half * (past - 2.0 * present + future)
    step = np.stack([present + share * moved, future - (1.0 - share) * moved], axis=-2)
    return largest_moduli(step)
