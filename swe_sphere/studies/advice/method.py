"""What a step of a method costs and errs by on a scene and mesh: power laws fitted to sweeps."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.io.norms import area_mean
from swe_sphere.operators.diagnose import divergence

if TYPE_CHECKING:
    from swe_sphere.mesh import Mesh
    from swe_sphere.simulation.snapshot import Fields
    from swe_sphere.studies.sweep.discretisation import Discretisation


@dataclass(frozen=True)
class Method:
    """A stepper, with the constants of

        cost of a step = k (1 + G)^a (1 + A)^b (1 + D)^d    [right-hand sides]
        slow-flow error = C (change T) (turning Δt)^p (U/c)^s (1 + D)^r

    G, A: the step over the gravity and the advective limit (which Krylov counts go with); D: times
    the spectral radius of the dissipation; T: length of the run.
    """

    stepper: str
    price: tuple[float, float, float, float]
    """log k, a, b, d."""
    accuracy: tuple[float, float, float, float]
    """log C, p, s, r."""
    doubt: float
    """Factor by which errors scatter about the law, one standard deviation."""
    reach: tuple[float, float]
    """The largest advective Courant number A and the longest step [s] at which it was seen to
    work; what has a stability limit is not held to them."""
    failures: tuple[tuple[float, float], ...]
    """(G, A) of runs that blew up or could not be solved, the lowest ones."""
    runs: int = field(compare=False)
    """That the constants were fitted to."""

    def works(self, setting: Setting, dt: float) -> bool:
        """Whether no run failed whose step was no longer in either limit."""
        here = dt / setting.gravity_limit, dt / setting.advective_limit
        return not any(g <= here[0] and a <= here[1] for g, a in self.failures)

    def step_cost(self, setting: Setting, dt: float) -> float:
        """Cost of a step of dt [s] in right-hand sides."""
        return math.exp(float(np.dot(self.price, price_terms(setting, dt))))

    def error(self, setting: Setting, dt: float) -> float:
        """Slow-flow error at the end of a run with steps of dt [s]."""
        if not setting.turning:
            return 0.0
        laws = np.dot(self.accuracy, error_terms(setting, dt))
        return setting.change * setting.seconds * math.exp(float(laws))


def price_terms(setting: Setting, dt: float) -> list[float]:
    """1, log (1 + G), log (1 + A) and log (1 + D) of a step of dt [s]."""
    rates = 1.0 / setting.gravity_limit, 1.0 / setting.advective_limit, setting.dissipation
    return [1.0, *(math.log1p(dt * rate) for rate in rates)]


def error_terms(setting: Setting, dt: float) -> list[float]:
    """1, log (turning Δt), log (U/c) and log (1 + D) of a step of dt [s]."""
    factors = dt * setting.turning, setting.froude, 1.0 + dt * setting.dissipation
    return [1.0, *map(math.log, factors)]


@dataclass(frozen=True)
class Setting:
    """The numbers that price and error of a step hang on."""

    gravity_limit: float
    """Longest step of leapfrog [s], the inverse of the spectral radius."""
    advective_limit: float
    """The same, were there no gravity waves [s]."""
    dissipation: float
    """Spectral radius of viscosity and hyperviscosity [s-1], 0 without."""
    change: float
    """How fast the slow flow changes in place, relative to its size [s-1]."""
    turning: float
    """How fast that change itself does [s-1]."""
    seconds: float
    """Length of the run [s]."""

    @property
    def froude(self) -> float:
        """U/c: largest wind over the speed of the fastest gravity waves."""
        return 1.0 / (self.advective_limit / self.gravity_limit - 1.0)


def setting_of(space: Discretisation, seconds: float) -> Setting:
    """That of a run of so many seconds.

    Raises:
        ConfigError: the scene has no gravity waves, or begins at rest.
    """
    scene, model = space.scene, space.model
    if scene.wind is not None or scene.effect("pressure-gradient") is None:
        raise ConfigError(
            f"{scene.name}: it has no gravity waves, which advice is about: the wind alone limits"
            f" its steps (swe-sphere run {scene.name} takes a safe one)"
        )
    fields = space.start
    if not np.isfinite(space.limits["advective_limit"]):
        raise ConfigError(
            f"{scene.name}: it begins at rest, so that nothing but gravity waves will move: advice"
            f" is about a slower flow (swe-sphere run {scene.name} takes a safe explicit step)"
        )
    change, turning = slow_frequencies(space.mesh, fields)
    damping = model.spectrum(model.initial_state()).dissipation if model.diffusive else 0.0
    return Setting(**space.limits, dissipation=damping, change=change, turning=turning,
                   seconds=seconds)  # fmt: skip


def slow_frequencies(mesh: Mesh, fields: Fields) -> tuple[float, float]:
    """|V·∇Q|/|Q| and |V·∇(V·∇Q)|/|V·∇Q| [s-1], Q = H (ζ + f)/h - f with H the mean depth.

    Potential vorticity q = (ζ + f)/h only moves with the wind, gravity waves or not; Q is what the
    slow-flow error of a sweep is taken of.  fields: u, v, h, vorticity and f, each (N,).
    """
    mean = area_mean(mesh.area, fields["h"])
    q = mean * (fields["vorticity"] + fields["f"]) / fields["h"]
    first = _advected(mesh, fields, q)
    second = _advected(mesh, fields, first)
    size, change, turn = (_norm(mesh, values) for values in (q - fields["f"], first, second))
    return change / size if size else 0.0, turn / change if change else 0.0


def _advected(mesh: Mesh, fields: Fields, scalar: Array) -> Array:
    """V·∇s = ∇·(s V) - s ∇·V (N,)."""
    u, v = fields["u"], fields["v"]
    return divergence(mesh, scalar * u, scalar * v) - scalar * divergence(mesh, u, v)


def _norm(mesh: Mesh, values: Array) -> float:
    return float(np.sqrt(area_mean(mesh.area, values**2)))
