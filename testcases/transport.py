"""Transport by prescribed stirring winds: moving vortices and deformational flow."""

from typing import Literal

import numpy as np

from swe_sphere.equations.effects import PrescribedWind, Tracers
from swe_sphere.equations.scene import Array, Scalar, Scene, Wind
from swe_sphere.mesh.sphere import frame, position
from swe_sphere.planet import EARTH
from swe_sphere.testcases import flows

AIR = 1000.0
"""Depth of the air that carries the tracers [m]."""


def moving_vortices(alpha: float = 0.25 * np.pi) -> Scene:
    """Two vortices that roll up a front while they go once around the planet (exact).

    Nair & Jablonowski (2008): in addition to the solid-body flow about the axis tilted by α, once
    around in T = 12 days, the air rotates about the moving vortex centre p at the angular speed ω =
    (3√3/2) (2π/T) sech²ρ tanh ρ / ρ, with ρ 3 times the distance from the axis through p, so that

        h = 1000 m (1 - tanh(ρ/5 sin(λ' - ω t))), λ' the longitude about p.

    Both λ' and p refer to a frame that moves with the solid-body flow: measuring λ' from the local
    north instead is wrong unless α is 0 or π/2. The tracer is the depth.

    Args:
        alpha: tilt of the axis [rad]; with π/4 the vortices pass over the corners of the cube.
    """
    start = position(1.5 * np.pi, 0.0)

    def wind(lon: Array, lat: Array, t: float) -> tuple[Array, Array]:
        centre = flows.turned(start, alpha, flows.ANGULAR_SPEED * t)
        point = position(lon, lat)
        angular_speed = _vortex_speed(point @ centre)
        swirl = np.cross(centre, point)
        east, north = (
            EARTH.radius
            * (flows.ANGULAR_SPEED * around + angular_speed * np.sum(swirl * axis, axis=-1))
            for around, axis in zip(flows.solid_body(lon, lat, alpha), frame(lon, lat), strict=True)
        )
        return east, north

    def exact(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        origin = flows.turned(position(lon, lat), alpha, -flows.ANGULAR_SPEED * t)
        return *wind(lon, lat, t), AIR * _rolled_front(origin, start, t)

    return flows.build_scene("moving-vortices", effects=(PrescribedWind(),), exact=exact, wind=wind)


def deformational(case: Literal[1, 2, 3, 4] = 4) -> Scene:
    """Tracers torn to filaments and brought back (exact after 12 days).

    Nair & Lauritzen (2010), cases 1 to 4: the wind deforms the tracers until day 6 and then
    reverses. Cases 1 and 2 contain only this deformation. In case 3 the wind diverges, and the
    depth of the air, initially 1000 m, varies. Case 4 adds a solid-body flow, so that errors do not
    cancel in the reversal. The four tracers are two Gaussian hills, two cosine bells, two slotted
    cylinders (from smooth to discontinuous), and -0.8 q² + 0.9 with q the bells: numerical mixing
    breaks this relation (Lauritzen, Skamarock, Prather & Taylor 2012).

    Args:
        case: number of the case, which selects the wind.
    """
    wind, centres = _CASES[case]
    tracers = _tracers(centres)

    def exact(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        known = _unless_away(t) if case == 3 else 0.0  # a wind that diverges changes the depth
        return *wind(lon, lat, t), AIR + known + 0.0 * (lon + lat)

    def exact_tracers(lon: Array, lat: Array, t: float) -> dict[str, Array]:
        return {name: formula(lon, lat) + _unless_away(t) for name, formula in tracers.items()}

    return flows.build_scene(
        "deformational", title=f"deformational flow, case {case}", exact=exact, wind=wind,
        effects=(PrescribedWind(), Tracers()), tracers=tracers, exact_tracers=exact_tracers,
    )  # fmt: skip


def _vortex_speed(sine: Array) -> Array:
    """Return the angular speed [s-1] about the vortex centre; sine: point · centre."""
    rho = 3.0 * np.sqrt(np.maximum(1.0 - sine**2, 0.0))
    safe = np.where(rho > 1e-8, rho, 1.0)
    shape = np.where(rho > 1e-8, np.tanh(safe) / safe, 1.0) / np.cosh(rho) ** 2
    return np.asarray(1.5 * np.sqrt(3.0) * flows.ANGULAR_SPEED * shape)


def _rolled_front(point: Array, centre: Array, t: float) -> Array:
    """Return the tracer (depth / `AIR`) at unit vectors (..., 3) at t [s] about a fixed centre."""
    lon, lat = np.arctan2(centre[1], centre[0]), np.arcsin(centre[2])
    east, north = frame(lon, lat)
    sine = point @ centre
    longitude = np.arctan2(point @ east, -(point @ north))
    rho = 3.0 * np.sqrt(np.maximum(1.0 - sine**2, 0.0))
    return 1.0 - np.tanh(0.2 * rho * np.sin(longitude - _vortex_speed(sine) * t))


def _cells(strength: float, north: float, k: float, power: int) -> Wind:
    """Return a deformation that reverses at half time, with the speed s = 5 a cos(π t/T) / T.

    u = strength s sin² kλ sin 2θ cos^power θ, v = north strength s sin 2kλ cos^(power + 1) θ.
    """

    def wind(lon: Array, lat: Array, t: float) -> tuple[Array, Array]:
        phase = np.pi * t / flows.PERIOD
        speed = strength * float(5.0 * EARTH.radius / flows.PERIOD * np.cos(phase))
        east = speed * np.sin(k * lon) ** 2 * np.sin(2.0 * lat) * np.cos(lat) ** power
        return east, north * speed * np.sin(2.0 * k * lon) * np.cos(lat) ** (power + 1)

    return wind


def _two_cells_turning(lon: Array, lat: Array, t: float) -> tuple[Array, Array]:
    east, north = _CASES[2][0](lon - flows.ANGULAR_SPEED * t, lat, t)
    return east + EARTH.radius * flows.ANGULAR_SPEED * np.cos(lat), north


Centres = tuple[tuple[float, float], tuple[float, float]]

_NEAR = ((5.0 * np.pi / 6.0, 0.0), (7.0 * np.pi / 6.0, 0.0))
_CASES: dict[int, tuple[Wind, Centres]] = {
    1: (_cells(2.4, 0.5, 0.5, 0), ((np.pi, np.pi / 3.0), (np.pi, -np.pi / 3.0))),
    2: (_cells(2.0, 1.0, 1.0, 0), _NEAR),
    3: (_cells(-1.0, -0.5, 0.5, 2), ((0.75 * np.pi, 0.0), (1.25 * np.pi, 0.0))),
    4: (_two_cells_turning, _NEAR),
}
"""Wind, and the centres of the tracers (lon, lat) [rad], by case."""


def _tracers(centres: Centres) -> dict[str, Scalar]:
    """Return the initial mixing ratios, as functions by name (Lauritzen et al. 2012, section 3)."""

    def gaussian_hills(lon: Array, lat: Array) -> Array:
        offsets = [position(lon, lat) - position(*centre) for centre in centres]
        return np.asarray(0.95 * np.sum(np.exp(-5.0 * np.sum(np.square(offsets), axis=-1)), axis=0))

    def cosine_bells(lon: Array, lat: Array) -> Array:
        far = (flows.distance(lon, lat, *centre) for centre in centres)
        one, other = (np.minimum(2.0 * x, 1.0) for x in far)
        return 0.1 + 0.45 * (2.0 + np.cos(np.pi * one) + np.cos(np.pi * other))

    def correlated(lon: Array, lat: Array) -> Array:
        return -0.8 * cosine_bells(lon, lat) ** 2 + 0.9

    def slotted_cylinders(lon: Array, lat: Array) -> Array:
        """Cylinders of radius 1/2 with a slot 1/6 wide, open to the north or to the south."""
        inside = np.zeros(np.shape(lon), dtype=bool)
        for centre, side in zip(centres, (-1.0, 1.0), strict=True):
            beside = np.abs(flows.wrapped(lon - centre[0])) >= 1.0 / 12.0
            beyond = side * (lat - centre[1]) > 5.0 / 24.0
            inside |= (flows.distance(lon, lat, *centre) <= 0.5) & (beside | beyond)
        return np.where(inside, 1.0, 0.1)

    found = (gaussian_hills, cosine_bells, correlated, slotted_cylinders)
    return {function.__name__: function for function in found}


def _unless_away(t: float) -> float:
    """Return 0 at multiples of the period, when all air is back at its origin, otherwise NaN."""
    return 0.0 if abs(t / flows.PERIOD - round(t / flows.PERIOD)) < 1e-9 else np.nan
