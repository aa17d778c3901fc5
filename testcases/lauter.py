"""Exact unsteady flows of Läuter, Handorf & Dethloff (2005), J. Comput. Phys. 210, 535-553.

doi:10.1016/j.jcp.2005.04.022
"""

import numpy as np

from swe_sphere.equations.effects import DYNAMICS, Orography, Rotation
from swe_sphere.equations.scene import Array, Scene
from swe_sphere.planet import DAY, EARTH
from swe_sphere.testcases.flows import solid_body, tilted_latitude
from swe_sphere.testcases.recommended import recommended

PAPER = (
    "Läuter, Handorf & Dethloff (2005), J. Comput. Phys. 210, 535-553, "
    "doi:10.1016/j.jcp.2005.04.022, example 3"
)
SPEED = 2.0 * np.pi * EARTH.radius / (12.0 * DAY)
"""Speed of the flow at its equator [m s-1]."""
SURFACE = 133681.0
"""The constant k1 in g (h + b) [m2 s-2]."""
BOTTOM = 10.0
"""The constant k2 in g b [m2 s-2]."""


@recommended(ne=8, np=8, dt=200.0, days=5.0)
def lauter(alpha: float = np.pi / 4.0) -> Scene:
    """Unsteady nonlinear flow over orography (exact).

    Smooth, fast and exact: the case to rank time integrators by.

    Solid-body flow about an axis tilted by α that is at rest among the stars, seen from the
    turning planet. With S the sine of the latitude above its equator, at longitude λ + Ω t,

        g (h + b) = k1 + (Ω a sin θ)²/2 - (u0 S + Ω a sin θ)²/2,  g b = (Ω a sin θ)²/2 + k2

    Depth lies between 1256.3 and 13631.3 m over a bottom up to 11 km, for α = π/4. One period is
    2 π / Ω = 86164 s.

    Args:
        alpha: tilt of the flow's axis [rad]; the flow is steady for 0.
    """

    def exact(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        fixed = lon + EARTH.rotation * t
        east, north = solid_body(fixed, lat, alpha)
        turning = _planet_speed(lat)
        total = SPEED * tilted_latitude(fixed, lat, alpha) + turning
        surface = (SURFACE + 0.5 * turning**2 - 0.5 * total**2) / EARTH.gravity
        return SPEED * east, SPEED * north, surface - bottom(lon, lat)

    return Scene(
        name="lauter",
        title="unsteady flow over orography",
        reference=PAPER,
        effects=(*DYNAMICS, Rotation(), Orography()),
        initial=lambda lon, lat: exact(lon, lat, 0.0),
        exact=exact,
        bottom=bottom,
        report="l2 of h and of the wind after 5 days, against the time step",
    )


def bottom(lon: Array, lat: Array) -> Array:
    """Return the height [m] of a bottom that makes up for the flattening of the planet."""
    return (0.5 * _planet_speed(lat) ** 2 + BOTTOM) / EARTH.gravity + 0.0 * lon


def _planet_speed(lat: Array) -> Array:
    """Ω a sin θ [m s-1]."""
    return EARTH.rotation * EARTH.radius * np.sin(lat)
