"""Gravity waves from heaps of water: one splash, three bumps, and a dam that breaks."""

import numpy as np

from swe_sphere.equations.effects import DYNAMICS, Orography, Rotation
from swe_sphere.equations.scene import Array, Scene
from swe_sphere.errors import ConfigError
from swe_sphere.planet import EARTH, Planet
from swe_sphere.testcases.flows import distance
from swe_sphere.testcases.recommended import recommended

CENTRE = (1.5 * np.pi, 0.0)
"""Longitude and latitude of the splash and of the dam [rad]."""
STILL = Planet(EARTH.radius, EARTH.gravity, 0.0)
WIND = 40.0
"""Speed at the equator of the air at rest among the stars, seen from the turning frame [m s-1]."""


@recommended(ne=16, np=4, dt=600.0, days=2.0)
def splash(rotating: bool = False) -> Scene:
    """Heap of water that spreads and meets itself at the antipode.

    Without wind and rotation,

        h = 2000 m + 500 m (1 + cos(3 π γ)) for γ < 1/3,

    γ the angular distance from (3π/2, 0). The crest comes together at the antipode after 1.44 days,
    before the 1.65 that a small wave would take. How high it stands then depends on the mesh.

    Args:
        rotating: the very same flow, seen from a frame that turns backwards by (40 m/s) / a: with
            u = 40 m/s cos θ, f = -2 (40 m/s / a) sin θ and, which many codes leave out, the
            bottom g b = (40 m/s sin θ)²/2 that stands for the centrifugal force. Depths are those
            of the still frame, turned eastward.
    """
    spin = WIND / EARTH.radius

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        within = np.minimum(3.0 * distance(lon, lat, *CENTRE), 1.0)
        depth = 2000.0 + 500.0 * (1.0 + np.cos(np.pi * within))
        return (WIND * np.cos(lat) if rotating else 0.0 * lat), 0.0 * lat, depth

    return Scene(
        name="splash",
        title="splash, seen from a turning frame" if rotating else "splash",
        reference="test 3 of FV3 (GFDL): Putman & Lin (2007), J. Comput. Phys. 227, 55-78, "
        "doi:10.1016/j.jcp.2007.07.022",
        effects=(*DYNAMICS, *((Rotation(), Orography()) if rotating else ())),
        initial=initial,
        bottom=_centrifugal if rotating else None,
        planet=Planet(EARTH.radius, EARTH.gravity, -spin) if rotating else STILL,
        report="time and height of the crest at the antipode; loss of symmetry about the centre",
    )


def _centrifugal(lon: Array, lat: Array) -> Array:
    return (WIND * np.sin(lat)) ** 2 / (2.0 * EARTH.gravity) + 0.0 * lon


BUMPS = ((0.2, 1.0 / 3.0, 10.0), (1.2, 0.2, 80.0), (1.6, -0.25, 360.0))
"""Longitude and latitude [π rad] and sharpness [rad-2] of each bump."""


@recommended(ne=16, np=4, dt=300.0, days=1.0)
def gravity_bumps() -> Scene:
    """Three bumps of different width that radiate gravity waves on the turning planet.

    From rest, h = 10 km + Σ 1000 m exp(-w d²), d the angular distance: w = 10 at (0.2π, π/3), 80 at
    (1.2π, π/5) and 360 at (1.6π, -π/4).
    """

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        distances = (distance(lon, lat, np.pi * x, np.pi * y) for x, y, _ in BUMPS)
        bumps = (np.exp(-w * d**2) for d, (_, _, w) in zip(distances, BUMPS, strict=True))
        return 0.0 * lon, 0.0 * lat, 1e4 + 1000.0 * sum(bumps, start=0.0 * lat)

    return Scene(
        name="gravity-bumps",
        title="gravity waves from three bumps",
        reference="asQ (Hope-Collins et al. 2025), Geosci. Model Dev. 18, 4535-4569, "
        "doi:10.5194/gmd-18-4535-2025",
        effects=(*DYNAMICS, Rotation()),
        initial=initial,
        report="depth at hours 6, 12 and 24 against a run with short steps; drift of energy",
    )


@recommended(ne=16, np=4, dt=600.0, days=1.0)
def dam_break(width: float = 0.05) -> Scene:
    """Circular dam of 20 degrees radius that breaks, smoothed.

    At rest and without rotation,

        h = 1500 m - 500 m tanh((γ - π/9) / width),

    γ the angular distance from (3π/2, 0). No limiter: the bore that steepens leaves waves at the
    grid scale behind it. A test of robustness, not of accuracy.

    Args:
        width: of the smoothed dam [rad]; it should not be less than half an element.

    Raises:
        ConfigError: a width that is not positive.
    """
    if not width > 0.0:
        raise ConfigError(f"dam-break: width must be positive, not {width}")

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        across = np.tanh((distance(lon, lat, *CENTRE) - np.pi / 9.0) / width)
        return 0.0 * lon, 0.0 * lat, 1500.0 - 500.0 * across

    return Scene(
        name="dam-break",
        title="circular dam break",
        reference="proposed here, after Rossmanith, Bale & LeVeque (2004), J. Comput. Phys. 199, "
        "631-662, doi:10.1016/j.jcp.2004.03.002",
        effects=DYNAMICS,
        initial=initial,
        planet=STILL,
        report="least and largest depth; depth along a meridian of the dam against a solution in"
        " the distance alone",
    )
