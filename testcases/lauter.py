"""Exact unsteady flows: at rest among the stars, and seen from the turning planet."""

import numpy as np

from swe_sphere.equations.effects import DYNAMICS, Orography, Rotation
from swe_sphere.equations.scene import Array, Scene
from swe_sphere.errors import ConfigError
from swe_sphere.planet import DAY, EARTH
from swe_sphere.testcases.flows import recommended, solid_body, tilted_latitude

PAPER = (
    "Läuter, Handorf & Dethloff (2005), J. Comput. Phys. 210, 535-553, "
    "doi:10.1016/j.jcp.2005.04.022"
)
EQUATOR = EARTH.rotation * EARTH.radius
"""Speed of the planet at its equator [m s-1]."""
SPEED = 2.0 * np.pi * EARTH.radius / (12.0 * DAY)
"""Speed of the flow at its equator [m s-1]."""
SURFACE = 133681.0
"""The constant k1 in g (h + b) [m2 s-2]."""
BOTTOM = 10.0
"""The constant k2 in g b [m2 s-2]."""
CENTRE = np.sin(np.pi / 4.0)
"""Sine of the latitude of the Gaussian jet, whose width is 0.2."""


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
        turning = EQUATOR * np.sin(lat)
        total = SPEED * tilted_latitude(fixed, lat, alpha) + turning
        surface = (SURFACE + 0.5 * turning**2 - 0.5 * total**2) / EARTH.gravity
        return SPEED * east, SPEED * north, surface - bottom(lon, lat)

    return Scene(
        name="lauter",
        title="unsteady flow over orography",
        reference=f"{PAPER}, example 3",
        effects=(*DYNAMICS, Rotation(), Orography()),
        initial=lambda lon, lat: exact(lon, lat, 0.0),
        exact=exact,
        bottom=bottom,
        report="l2 of h and of the wind after 5 days, against the time step",
    )


def bottom(lon: Array, lat: Array) -> Array:
    """Return the height [m] of a bottom that makes up for the flattening of the planet."""
    return (0.5 * (EQUATOR * np.sin(lat)) ** 2 + BOTTOM) / EARTH.gravity + 0.0 * lon


@recommended(ne=8, np=6, dt=200.0, days=1.0)
def tilted_jet(alpha: float = 0.08, speed: float = 40.0, gaussian: bool = False) -> Scene:
    """Unsteady jet about a tilted axis, over orography (exact).

    Among the stars the wind is U = (Ω a + F(S)) cos θ' about an axis tilted by α against the
    planet's, with S = sin θ' the sine of the latitude above the equator of the flow. The bottom
    g b = (Ω a sin θ)²/2 makes up for the flattening of the planet, so that the flow is steady there
    and g h = const - ∫ (Ω a + F)² S dS. Seen from the planet it turns once a day.

    Args:
        alpha: Tilt of the axis of the flow [rad]; the flow is steady for 0.
        speed: Largest wind of the jet [m s-1].
        gaussian: Whether F is a Gaussian about 45°N; otherwise it is proportional to S².

    Raises:
        ConfigError: the depth is not positive everywhere.
    """

    def jet(s: Array) -> Array:
        """Ω a + F [m s-1] at the sine of a latitude."""
        shape = 1.5 * np.sqrt(3.0) * s**2
        if gaussian:
            shape = np.exp(-(((s - CENTRE) / 0.2) ** 2)) / np.cos(np.pi / 4.0)
        flow: Array = EQUATOR + speed * shape
        return flow

    points, weights = np.polynomial.legendre.leggauss(64)  # right to round-off

    def depth(s: Array) -> Array:
        """Depth [m] at the sine of a latitude."""
        sines = 0.5 * np.asarray(s)[..., None] * (1.0 + points)
        fall: Array = 0.5 * s * ((jet(sines) ** 2 * sines) @ weights)
        return (160000.0 - fall) / EARTH.gravity

    lowest = float(depth(np.array([-1.0, 1.0])).min())
    if not lowest > 0.0:
        raise ConfigError(f"tilted-jet: a jet of {speed} m/s leaves no water at the pole")

    def exact(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        fixed = lon + EARTH.rotation * t
        east, north = solid_body(fixed, lat, alpha)
        sine = tilted_latitude(fixed, lat, alpha)
        flow = jet(sine)
        return flow * east - EQUATOR * np.cos(lat), flow * north, depth(sine)

    return Scene(
        name="tilted-jet",
        title="unsteady jet about a tilted axis",
        reference=f"a jet in the place of the solid-body flow of {PAPER}",
        effects=(*DYNAMICS, Rotation(), Orography()),
        initial=lambda lon, lat: exact(lon, lat, 0.0),
        exact=exact,
        bottom=bottom,
        report="l2 of h and of the wind after a day, against the resolution",
    )
