"""The test set of Williamson, Drake, Hack, Jakob & Swarztrauber (1992), J. Comput. Phys. 102.

doi:10.1016/S0021-9991(05)80016-6
"""

import numpy as np

from swe_sphere.equations.effects import DYNAMICS, Orography, PrescribedWind, Rotation
from swe_sphere.equations.scene import Array, Scene, UnsteadyState, Wind
from swe_sphere.mesh.sphere import angle, position
from swe_sphere.planet import DAY, EARTH
from swe_sphere.testcases.flows import cone, solid_body, tilted_latitude, turned
from swe_sphere.testcases.recommended import recommended
from swe_sphere.testcases.zonal import ZonalJet

PAPER = "Williamson et al. (1992), J. Comput. Phys. 102, 211-224, doi:10.1016/S0021-9991(05)80016-6"
TURN = 12.0 * DAY
"""Time in which the solid-body flow goes once around the planet [s]."""
SPEED = 2.0 * np.pi * EARTH.radius / TURN
"""Speed of the solid-body flow at its equator [m s-1]."""
JET = ZonalJet(SPEED, -np.pi / 6.0, np.pi / 2.0, sharpness=(2.0 * np.pi / 3.0) ** 2 / 0.3)
"""The jet of case 3, at latitudes of its own axis; 0.3 is x_e of the paper."""


@recommended(ne=16, np=4, dt=1200.0, days=12.0)
def williamson1(alpha: float = 0.0, gaussian: bool = False) -> Scene:
    """Advection of a bell once around the planet (exact).

    Case 1. The wind is solid-body rotation about an axis tilted by α; the bell only moves:

        h = 500 m (1 + cos(π r / R)) for r < R = a/3, r the distance from the bell's centre.

    Args:
        alpha: tilt of the axis [rad]; 0, 0.05, π/2 - 0.05, π/2, and π/4 over the cube's corners.
        gaussian: the smooth bell 1000 m exp(-5 |n - n0|²) (TrixiAtmo) for tests of order; the
            cosine bell has only one continuous derivative.
    """
    bell = _gaussian_bell if gaussian else _cosine_bell
    wind = _solid_body_wind(alpha)

    def exact(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        centre = turned(position(1.5 * np.pi, 0.0), alpha, 2.0 * np.pi * t / TURN)
        return *wind(lon, lat, t), bell(position(lon, lat), centre)

    return Scene(
        name="williamson1",
        title="advection of a bell",
        reference=f"{PAPER}, case 1",
        effects=(PrescribedWind(),),
        initial=lambda lon, lat: exact(lon, lat, 0.0),
        exact=exact,
        wind=wind,
        steady_wind=True,
        report="l1, l2, linf, minimum and maximum of h after 12 days",
    )


@recommended(ne=16, np=4, dt=600.0, days=5.0)
def williamson2(alpha: float = 0.0) -> Scene:
    """Steady solid-body flow in geostrophic balance (exact).

    Case 2. With θ' the latitude above the equator of the axis tilted by α:

        g h = g h0 - (a Ω u0 + u0²/2) sin² θ',  f = 2 Ω sin θ',  g h0 = 2.94e4 m² s⁻²

    Args:
        alpha: tilt of the axis of flow and of rotation [rad]; 0, 0.05, π/4, π/2 - 0.05, π/2.
    """
    wind = _solid_body_wind(alpha)
    fall = (EARTH.radius * EARTH.rotation * SPEED + 0.5 * SPEED**2) / EARTH.gravity

    def exact(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        depth = 2.94e4 / EARTH.gravity - fall * tilted_latitude(lon, lat, alpha) ** 2
        return *wind(lon, lat, t), depth

    return _steady(2, "steady geostrophic flow", exact, alpha)


@recommended(ne=8, np=8, dt=300.0, days=5.0)
def williamson3(alpha: float = 0.0) -> Scene:
    """Steady jet of compact support in geostrophic balance (exact).

    Case 3. With θ' the latitude above the equator of the axis tilted by α, x = 0.3 (θ' + π/6) /
    (2π/3) and b(x) = exp(-1/x) for x > 0, 0 elsewhere,

        u' = u0 b(x) b(0.3 - x) exp(4/0.3),  g h = g h0 - ∫ (2 Ω a sin θ' + u' tan θ') u' dθ'

    The largest wind, u0 = 2 π a / 12 days, is at θ' = π/6. Infinitely smooth, but not analytic at
    the rims of the jet: spectral convergence sets in late.

    Args:
        alpha: tilt of the axis of flow and of rotation [rad]; 0 and π/3 in the paper.
    """

    def exact(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        sine = np.clip(tilted_latitude(lon, lat, alpha), -1.0, 1.0)
        east, north = solid_body(lon, lat, alpha)
        around = np.hypot(east, north)  # cosine of the tilted latitude
        latitude = np.arctan2(sine, around)
        turning = JET(latitude) / np.where(around > 0.0, around, 1.0)
        depth = (2.94e4 - JET.balance.drop(latitude)) / EARTH.gravity
        return turning * east, turning * north, depth

    return _steady(3, "steady jet of compact support", exact, alpha)


def _steady(case: int, title: str, exact: UnsteadyState, alpha: float) -> Scene:
    """A steady flow about an axis of rotation that is tilted by alpha [rad]."""
    return Scene(
        name=f"williamson{case}",
        title=title,
        reference=f"{PAPER}, case {case}",
        effects=(*DYNAMICS, Rotation()),
        initial=lambda lon, lat: exact(lon, lat, 0.0),
        exact=exact,
        coriolis=lambda lon, lat: 2.0 * EARTH.rotation * tilted_latitude(lon, lat, alpha),
        report="l1, l2, linf of h and of the wind after 5 days",
    )


@recommended(ne=8, np=6, dt=600.0, days=15.0)
def williamson5(speed: float = 20.0) -> Scene:
    """Zonal flow over an isolated mountain.

    Case 5: u = u0 cos θ, u0 = 20 m/s, and the surface in balance with it over a cone of 2000 m,

        h + b = 5960 m - (a Ω u0 + u0²/2) sin² θ / g

    Errors of height are those of the free surface. The impulsive start radiates gravity waves
    that carry about 7e-4 (relative l2) of the height, which time steps longer than they can follow
    lose. The recommended mesh is the one on which rk4 comes soonest to an error of 1e-4 at day 15;
    ne8 np8 comes to 4e-5.

    Args:
        speed: u0 [m s-1], 20 in the paper; gravity waves move at 240 m/s.
    """
    fall = (EARTH.radius * EARTH.rotation * speed + 0.5 * speed**2) / EARTH.gravity

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        surface = 5960.0 - fall * np.sin(lat) ** 2
        return speed * np.cos(lat), 0.0 * lat, surface - cone(lon, lat)

    return Scene(
        name="williamson5",
        title="zonal flow over a mountain",
        reference=f"{PAPER}, case 5",
        effects=(*DYNAMICS, Rotation(), Orography()),
        initial=initial,
        bottom=cone,
        report="l1, l2, linf of the free surface at days 5, 10, 15 against a reference; "
        "drift of mass, energy and potential enstrophy",
        error_field="surface",
        sheds_waves=True,
    )


@recommended(ne=16, np=4, dt=360.0, days=14.0)
def williamson6(perturbation: float = 0.0, omega: float = 7.848e-6) -> Scene:
    """Rossby-Haurwitz wave of zonal wavenumber 4.

    Case 6. The wave turns eastward by about 12 degrees a day (exactly so only without divergence)
    and keeps its shape until truncation errors or the physical instability break it.

    Args:
        perturbation: size δ [m] of a documented disturbance of the depth, for a breakdown that
            does not hang on round-off and mesh: h + δ/3 Σ cos^m θ cos(m λ + m), m = 1, 2, 3; a
            metre breaks the wave at about day 21 (the instability is that of Thuburn & Li 2000).
        omega: strength ω = K of the flow [s-1]; the largest wind goes with it.
    """

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        u, v, h = _rossby_haurwitz(lon, lat, omega)
        waves = (np.cos(lat) ** m * np.cos(m * lon + m) for m in (1, 2, 3))
        return u, v, h + perturbation / 3.0 * sum(waves) if perturbation else h

    return Scene(
        name="williamson6",
        title="Rossby-Haurwitz wave",
        reference=f"{PAPER}, case 6",
        effects=(*DYNAMICS, Rotation()),
        initial=initial,
        report="height at days 7 and 14 against a reference; drift of mass, energy and potential "
        "enstrophy; loss of the fourfold symmetry",
        sheds_waves=True,
    )


def _rossby_haurwitz(lon: Array, lat: Array, k: float) -> tuple[Array, Array, Array]:
    """Wind [m s-1] and depth [m] of the wave of case 6, R = 4, ω = K = k [s-1]."""
    r, a, omega = 4, EARTH.radius, EARTH.rotation
    c, s = np.cos(lat), np.sin(lat)
    u = a * k * (c + c ** (r - 1) * (r * s**2 - c**2) * np.cos(r * lon))
    v = -a * k * r * c ** (r - 1) * s * np.sin(r * lon)
    # the paper's c⁻² is multiplied in: nothing is infinite at the poles
    zonal = 0.5 * k * (2.0 * omega + k) * c**2 + 0.25 * k**2 * c ** (2 * r - 2) * (
        (r + 1) * c**4 + (2 * r**2 - r - 2) * c**2 - 2 * r**2
    )
    once = 2.0 * (omega + k) * k / ((r + 1) * (r + 2)) * c**r
    once = once * ((r**2 + 2 * r + 2) - (r + 1) ** 2 * c**2)
    twice = 0.25 * k**2 * c ** (2 * r) * ((r + 1) * c**2 - (r + 2))
    wave = zonal + once * np.cos(r * lon) + twice * np.cos(2 * r * lon)
    return u, v, 8000.0 + a**2 * wave / EARTH.gravity


def _solid_body_wind(alpha: float) -> Wind:
    """Solid-body rotation once in 12 days about the axis tilted by alpha [rad]."""

    def wind(lon: Array, lat: Array, t: float) -> tuple[Array, Array]:
        east, north = solid_body(lon, lat, alpha)
        return SPEED * east, SPEED * north

    return wind


def _cosine_bell(point: Array, centre: Array) -> Array:
    """Depth [m] at unit vectors (..., 3)."""
    within = np.minimum(3.0 * angle(point, centre), 1.0)
    return 500.0 * (1.0 + np.cos(np.pi * within))


def _gaussian_bell(point: Array, centre: Array) -> Array:
    """Depth [m] at unit vectors (..., 3)."""
    depth: Array = 1000.0 * np.exp(-5.0 * np.sum((point - centre) ** 2, axis=-1))
    return depth
