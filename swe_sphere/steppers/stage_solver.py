"""Solvers of the equations in a step: their norm, tolerance and results."""

import math
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.equations.model import Model
from swe_sphere.equations.tracer_equations import MassFlux, mixing_ratios
from swe_sphere.errors import ConfigError, SolverFailed
from swe_sphere.solvers.gravity_waves import GravityWaves
from swe_sphere.solvers.vector_space import VectorSpace

SHARE = 0.45
"""Fraction of the least truncation error of a step that the solver may add to it."""
PROBE = 1e-2
"""Fraction of a time step after which the slope is sampled again to find its rate of change."""
TRACER_SHARE = 0.1
"""Approximate Froude number of atmospheric flow, by which the change of a tracer that the wind
carries has the same weight as the change of the wind."""
NOTHING = 1e-60
"""Weight, or mixing ratio, that counts as none, because weights must be positive and finite."""
RESIDUAL_FLOOR = 0.1
"""A residual below this many round-offs of the state is reduced by one iteration only, as rounding
causes as much.  With a larger number such residuals accumulate in float32 with short steps."""


def energy_weights(model: Model) -> Array:
    """Return weights (n,) of the energy inner product: area, times g/H for depth, over all area.

    With them a norm is in [m s-1], in [m] under a prescribed wind; tolerances are independent of
    units and planet. The mass hq of a tracer counts as depth does, over the largest initial q, and
    with a prognostic wind by `TRACER_SHARE` of that; an accumulated mass flux has no weight.
    """
    share: Array = model.mesh.area / model.mesh.area.sum()
    ratios = mixing_ratios(model.scene, model.mesh).values()
    largest = [max(float(np.abs(q).max()), NOTHING) if q.any() else 1.0 for q in ratios]
    if model.scene.wind is not None:
        return np.concatenate([share, *(share / q**2 for q in largest)])
    _, _, depth = model.scene.initial(model.mesh.lon, model.mesh.lat)
    heights = share * model.scene.planet.gravity / float(np.average(depth, weights=share))
    if isinstance(model.carried, MassFlux):
        return np.concatenate([share, share, heights, NOTHING * share, NOTHING * share])
    tracers = (heights * (TRACER_SHARE / q) ** 2 for q in largest)
    return np.concatenate([share, share, heights, *tracers])


def energy_space(model: Model, copies: int = 1) -> VectorSpace:
    """Return the space of states, or of `copies` of them, with the mean energy inner product."""
    return VectorSpace(np.tile(energy_weights(model), copies) / copies, mesh=model.device_mesh)


class TimeDerivatives:
    """Time derivatives of the state by differences of its mean slopes over the last steps.

    rate |x'| per second in the energy norm; frequencies |x''|/|x'| and |x'''|/|x''| [s-1], of
    which the second is at least the first for a sum of oscillations (Cauchy-Schwarz: |x''|^2 <=
    |x'| |x'''|, and so on for all derivatives). The truncation error of a scheme of order p is
    therefore at least C f_1 f_2^(p-1) dt^p |x'| dt per step.
    """

    def __init__(self, space: VectorSpace) -> None:
        self.space = space
        self._work = space.zeros()
        self.mean_slope = space.zeros()
        """Change over the last step, divided by its length."""
        self.curvature = space.zeros()
        """x'' between the last two steps."""
        self.rate, self.last_dt = 0.0, 0.0
        """|x'|, and the length [s] of the last step, which is 0 before the first."""
        self.frequencies = (0.0, 0.0)

    def accept(self, old: wp.array, new: wp.array, dt: float) -> None:
        """Record a step of dt [s] between two states."""
        space, slope, curvature, before = self.space, self._work, self.mean_slope, self.curvature
        apart = 0.5 * (dt + self.last_dt)
        space.axpby(1.0 / dt, new, -1.0 / dt, old, slope)
        space.axpby(1.0 / apart, slope, -1.0 / apart, curvature)
        pairs = (curvature, curvature), (before, before), (curvature, before), (slope, slope)
        now, then, both, square = map(float, space.dots(*pairs))
        self.rate = math.sqrt(square)
        first = _ratio(math.sqrt(now), self.rate)
        second = _ratio(math.sqrt(max(now - 2.0 * both + then, 0.0) / now), dt) if now else first
        self.frequencies = first, (max(first, second) if then else first)
        self.mean_slope, self.curvature, self._work, self.last_dt = slope, curvature, before, dt

    def truncation(self, constant: float, order: int, dt: float) -> float:
        """Return the permitted residual in a step of dt [s] of a scheme with error constant C.

        It is `SHARE` of the least truncation error, relative to the change over the step.
        """
        first, second = (min(1.0, f * dt) for f in self.frequencies)
        return SHARE * constant * first * float(second ** (order - 1))

    def arrays(self) -> dict[str, wp.array]:
        return {"mean_slope": self.mean_slope, "curvature": self.curvature}

    def numbers(self) -> dict[str, NDArray[Any]]:
        """Return the numbers that an exact restart needs in addition to `arrays`."""
        return {"time_derivatives": np.array([self.rate, self.last_dt, *self.frequencies])}

    def load_numbers(self, saved: dict[str, NDArray[Any]]) -> None:
        self.rate, self.last_dt, first, second = saved["time_derivatives"].tolist()
        self.frequencies = first, second


def _ratio(above: float, below: float) -> float:
    """Return the quotient; 0 for a zero numerator, infinity if only the denominator is zero."""
    if above == 0.0:
        return 0.0
    return above / below if below > 0.0 else math.inf


class StageSolver(TimeDerivatives):
    """A solver of stages whose residuals are below the truncation error of a step.

    `tolerance`: largest residual, relative to the change over tau; the target is a fraction of
    the estimated truncation error, if smaller. ConfigError for one out of range.
    """

    def __init__(self, model: Model, tolerance: float) -> None:
        if not 0.0 <= tolerance < 1.0:
            raise ConfigError(f"the solver tolerance must be in [0, 1), got {tolerance}")
        super().__init__(energy_space(model))
        self.model = model
        self.largest_tolerance = tolerance
        """Largest residual that a solve may leave, relative to the change over its tau."""
        self.tolerance = tolerance
        """Residual of the solves of the present step, relative to the change over their tau."""
        self.counters = model.counters
        self.counters["krylov_iterations"] = 0
        self.state: wp.array = None
        """The state from which the present step is taken."""
        waves = model.scene.effect("pressure-gradient") is not None
        self._needs_depth = waves and not model.scene.linear

    def start(self, state: wp.array, t: float, dt: float) -> wp.array:
        """Start at a state at t [s], from which steps of dt [s] are taken; return the slope F.

        The returned array is that of the slope, not a copy.
        """
        space, slope, curvature, probe = self.space, self.mean_slope, self.curvature, PROBE * dt
        self.model.tendency(state, t, slope)
        space.axpby(probe, slope, 1.0, state, self._work)
        self.model.tendency(self._work, t + probe, curvature)
        space.axpy(-1.0, slope, curvature)
        self.rate, self.last_dt = space.norm(slope), 0.0
        self.frequencies = (_ratio(space.norm(curvature), probe * self.rate),) * 2
        space.clear(curvature)
        return slope

    def aim(self, state: wp.array, error_constant: float, order: int, dt: float) -> None:
        """Set the tolerance for a step of dt [s] from a state by its truncation error.

        error_constant: C in the truncation error C dt^(order + 1) d^(order + 1)x/dt^(order + 1).
        """
        self.state = state
        self.tolerance = min(self.largest_tolerance, self.truncation(error_constant, order, dt))

    def reject(self) -> None:
        """Discard the results of the solves of the present step."""

    def residual_floor(self) -> float:
        """Return the residual that justifies one iteration, not two; 0 if the tolerance is 0."""
        least = RESIDUAL_FLOOR * self.space.epsilon * self.space.norm(self.state)
        return least if self.largest_tolerance > 0.0 else 0.0

    def fault(self, state: wp.array) -> str | None:
        """Return the fault of a new state, if any: gravity waves require a positive depth."""
        if not self._needs_depth:
            return None
        end = self.model.fluid_size
        lowest = self.space.lowest(state, end - self.model.device_mesh.size, end)
        falls = "is not a number" if math.isinf(lowest) else f"falls to {lowest:.3g} m"
        return None if lowest > 0.0 else f"the depth {falls}"


class WaveSolver(StageSolver):
    """Solver of (I - tau L) x = r, with L of `GravityWaves`.

    name: the stepper's, for messages.  Raises ConfigError for a scene without gravity waves.
    """

    def __init__(self, model: Model, tolerance: float, name: str) -> None:
        super().__init__(model, tolerance)
        self.waves, self._name = GravityWaves(model), name
        depth = float(self.waves.depth.mean())
        self._depth_per_wind = math.sqrt(depth / model.scene.planet.gravity)
        """Change of depth [m] with the energy of a change of wind of 1 m/s."""
        self._floor = RESIDUAL_FLOOR * self.space.epsilon * depth * (tolerance > 0.0)  # [m]

    def solve(
        self, tau: float, t: float, r: wp.array, guess: wp.array | None, out: wp.array,
        change: float = 0.0,
    ) -> None:  # fmt: skip
        """Set out = (I - tau L)^-1 r, both states, from a guess of its depth (N,), from t [s] on.

        guess: None for 0; change: norm [m s-1] of the change to which the tolerance is relative; 0:
        the eliminated equation's right-hand side. Raises SolverFailed if it does not converge.
        """
        self.waves.setup(tau)
        target = max(self.tolerance * self._depth_per_wind * change, self._floor)
        result = self.waves.solve(r, guess, out, 0.0 if change else self.tolerance, target)
        self.counters["krylov_iterations"] += result.iterations
        if not result.converged:
            raise SolverFailed(
                f"{self._name}: the gravity waves at {t:.0f} s cannot be solved for: "
                f"{result.message}; choose a smaller --dt"
            )
