"""Scenes without wind or without rotation: lake at rest, splash, dam break, modons."""

import numpy as np

from swe_sphere.equations.effects import DYNAMICS, Hyperviscosity, Orography
from swe_sphere.equations.scene import Array, Scene
from swe_sphere.errors import ConfigError
from swe_sphere.mesh.sphere import position
from swe_sphere.planet import EARTH, Planet
from swe_sphere.testcases.flows import ROTATING, build_scene, distance
from swe_sphere.testcases.flows import cone as conical_mountain

CENTRE = (1.5 * np.pi, 0.0)
"""Longitude and latitude of the splash and of the dam [rad]."""
NON_ROTATING = Planet(EARTH.radius, EARTH.gravity, 0.0)


def lake_at_rest(cone: bool = True, rotating: bool = True) -> Scene:
    """Water at rest over a mountain (exact): nothing may move.

    The surface is at 5960 m. Any motion shows that gradients of bottom and depth do not cancel.

    Args:
        cone: use the cone of williamson5; otherwise the smooth mountain 2000 m exp(-|n - n0|²/w²)
            with w = π/18, unit vectors n and n0 at the centre of that cone.
        rotating: include the Coriolis force.
    """
    bottom = conical_mountain if cone else _smooth_bottom
    return build_scene(
        "lake-at-rest", effects=(*(ROTATING if rotating else DYNAMICS), Orography()),
        exact=lambda lon, lat, t: (0.0 * lon, 0.0 * lat, 5960.0 - bottom(lon, lat)), bottom=bottom,
        error_field="surface",
    )  # fmt: skip


def _smooth_bottom(lon: Array, lat: Array) -> Array:
    """Height [m] of a smooth mountain at (3π/2, π/6)."""
    offset = position(lon, lat) - position(1.5 * np.pi, np.pi / 6.0)
    return np.asarray(2000.0 * np.exp(-np.sum(offset**2, axis=-1) / (np.pi / 18.0) ** 2))


def splash() -> Scene:
    """Heap of water that spreads and meets itself at the antipode.

    Without wind and rotation,

        h = 2000 m + 500 m (1 + cos(3 π γ)) for γ < 1/3, 2000 m elsewhere,

    with γ the angular distance from (3π/2, 0). The crest converges at the antipode after 1.44 days;
    a small wave takes 1.65 days. The height of the crest at the antipode depends on the mesh.
    """

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        within = np.minimum(3.0 * distance(lon, lat, *CENTRE), 1.0)
        return 0.0 * lat, 0.0 * lat, 2000.0 + 500.0 * (1.0 + np.cos(np.pi * within))

    return build_scene("splash", effects=DYNAMICS, initial=initial, planet=NON_ROTATING)


def gravity_bumps() -> Scene:
    """Three bumps of different width radiating gravity waves on the rotating planet.

    The fluid is initially at rest with h = 10 km + Σ 1000 m exp(-w d²), where d is the angular
    distance: w = 10 at (0.2π, π/3), 80 at (1.2π, π/5) and 360 at (1.6π, -π/4).
    """
    bumps = ((0.2, 1.0 / 3.0, 10.0), (1.2, 0.2, 80.0), (1.6, -0.25, 360.0))

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        heaps = (np.exp(-w * distance(lon, lat, np.pi * x, np.pi * y) ** 2) for x, y, w in bumps)
        return 0.0 * lon, 0.0 * lat, 1e4 + 1000.0 * sum(heaps, start=0.0 * lat)

    return build_scene("gravity-bumps", effects=ROTATING, initial=initial)


def dam_break(width: float = 0.05) -> Scene:
    """Circular dam of 20 degrees radius that breaks, smoothed.

    The fluid is initially at rest, without rotation, with

        h = 1500 m - 500 m tanh((γ - π/9) / width),

    where γ is the angular distance from (3π/2, 0). No limiter acts on the depth: the steepening
    bore leaves grid-scale waves behind. The scene tests robustness, not accuracy.

    Args:
        width: width of the smoothed dam [rad]; it should be at least half an element.

    Raises ConfigError for a width that is not positive.
    """
    if not width > 0.0:
        raise ConfigError(f"dam-break: width must be positive, got {width}")

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        across = np.tanh((distance(lon, lat, *CENTRE) - np.pi / 9.0) / width)
        return 0.0 * lon, 0.0 * lat, 1500.0 - 500.0 * across

    return build_scene("dam-break", effects=DYNAMICS, initial=initial, planet=NON_ROTATING)


def modons() -> Scene:
    """Two pairs of vortices that collide, exchange partners and come back.

    The planet does not rotate, the depth is 5000 m everywhere, and the wind is two zonal bursts

        u = 50 m/s (exp(-(r1/r0)²) - exp(-(r2/r0)²)),  r0 = 750 km

    with r1, r2 the distances to (π/2, 0) and (3π/2, 0). Gravity waves leave first. The modons that
    form collide near λ = π and λ = 0 and return close to their origin after about 100 days. The
    flow stays symmetric about the equator, and about the meridians λ = 0 and π. Hyperviscosity of
    30 times the default coefficient of the mesh removes grid-scale enstrophy.
    """

    def burst(lon: Array, lat: Array, centre: float) -> Array:
        return np.exp(-((EARTH.radius * distance(lon, lat, centre, 0.0) / 750e3) ** 2))

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        speed = 50.0 * (burst(lon, lat, 0.5 * np.pi) - burst(lon, lat, 1.5 * np.pi))
        return speed, 0.0 * lat, 5000.0 + 0.0 * lat

    effects = (*DYNAMICS, Hyperviscosity(factor=30.0))
    return build_scene("modons", effects=effects, initial=initial, planet=NON_ROTATING)
