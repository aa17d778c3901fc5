"""The test set of Williamson, Drake, Hack, Jakob & Swarztrauber (1992), J. Comput. Phys. 102.

doi:10.1016/S0021-9991(05)80016-6. Case 7 has a separate file. McDonald & Bates (1989) are added.
"""

import numpy as np

from swe_sphere.equations.effects import Forcing, Orography, PrescribedWind
from swe_sphere.equations.scene import Array, Scene, UnsteadyState
from swe_sphere.mesh.sphere import angle, position
from swe_sphere.planet import EARTH
from swe_sphere.testcases import flows

SPEED = EARTH.radius * flows.ANGULAR_SPEED
"""Speed of the solid-body flow at its equator [m s-1]."""
JET = flows.ZonalJet(SPEED, -np.pi / 6.0, np.pi / 2.0, sharpness=(2.0 * np.pi / 3.0) ** 2 / 0.3)
"""The jet of case 3 by the latitude relative to its axis; 0.3 is x_e of the paper."""

GEOPOTENTIAL = 1e5
"""g h0 of case 4 [m2 s-2]: g h at the poles."""
LOW_LATITUDE = np.pi / 4.0
"""Latitude of the low of case 4 [rad]."""
STRENGTH = -0.03 * GEOPOTENTIAL / (2.0 * EARTH.rotation * np.sin(LOW_LATITUDE))
"""Streamfunction ψ0 at the centre of the low of case 4 [m2 s-1]."""
SHARPNESS = (2.0 * EARTH.radius / 1e6) ** 2
"""The constant σ of case 4."""


def williamson1(alpha: float = 0.0, gaussian: bool = False) -> Scene:
    """Advection of a bell once around the planet (exact).

    Case 1. The wind is a solid-body rotation about an axis tilted by α; it moves the bell

        h = 500 m (1 + cos(π r / R)) for r < R = a/3, r the distance from the centre of the bell.

    Args:
        alpha: tilt [rad]: 0, 0.05, π/2 - 0.05, π/2 in the paper; π/4 crosses the cube's corners.
        gaussian: use the smooth bell 1000 m exp(-5 |n - n0|²) of TrixiAtmo, with unit vectors n and
            n0 (centre), to test orders; the cosine bell has only one continuous derivative.
    """

    def wind(lon: Array, lat: Array, t: float) -> tuple[Array, Array]:
        return flows.solid_body(lon, lat, alpha, SPEED)

    def exact(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        centre = flows.turned(position(1.5 * np.pi, 0.0), alpha, flows.ANGULAR_SPEED * t)
        point = position(lon, lat)
        if gaussian:
            depth = 1000.0 * np.exp(-5.0 * np.sum((point - centre) ** 2, axis=-1))
        else:
            depth = 500.0 * (1.0 + np.cos(np.pi * np.minimum(3.0 * angle(point, centre), 1.0)))
        return *wind(lon, lat, t), depth

    return flows.build_scene(
        "williamson1", effects=(PrescribedWind(),), exact=exact, wind=wind, steady_wind=True
    )


def williamson2(alpha: float = 0.0) -> Scene:
    """Steady solid-body flow in geostrophic balance (exact).

    Case 2. With θ' the latitude above the equator of the axis tilted by α:

        g h = g h0 - (a Ω u0 + u0²/2) sin² θ',  f = 2 Ω sin θ',  g h0 = 2.94e4 m² s⁻²

    Args:
        alpha: tilt of the axis of flow and rotation [rad]; 0, 0.05, π/2 - 0.05, π/2 in the paper.
    """
    fall = (EARTH.radius * EARTH.rotation * SPEED + 0.5 * SPEED**2) / EARTH.gravity

    def exact(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        depth = 2.94e4 / EARTH.gravity - fall * flows.sin_tilted_latitude(lon, lat, alpha) ** 2
        return *flows.solid_body(lon, lat, alpha, SPEED), depth

    return _steady(2, exact, alpha)


def williamson3(alpha: float = 0.0) -> Scene:
    """Steady jet of compact support in geostrophic balance (exact).

    Case 3. With θ' the latitude above the equator of the axis tilted by α, x = 0.3 (θ' + π/6) /
    (2π/3) and b(x) = exp(-1/x) for x > 0, 0 elsewhere,

        u' = u0 b(x) b(0.3 - x) exp(4/0.3),  g h = g h0 - ∫ (2 Ω a sin θ' + u' tan θ') u' dθ'

    The largest wind, u0 = 2 π a / 12 days, is at θ' = π/6. The jet is infinitely smooth but not
    analytic at its edges; spectral convergence therefore sets in only on fine meshes.

    Args:
        alpha: tilt of the axis of flow and of rotation [rad]; 0 and π/3 in the paper.
    """

    def exact(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        sine = np.clip(flows.sin_tilted_latitude(lon, lat, alpha), -1.0, 1.0)
        east, north = flows.solid_body(lon, lat, alpha)
        around = np.hypot(east, north)  # cosine of the tilted latitude
        latitude = np.arctan2(sine, around)
        turning = JET(latitude) / np.where(around > 0.0, around, 1.0)
        return turning * east, turning * north, (2.94e4 - JET.drop(latitude)) / EARTH.gravity

    return _steady(3, exact, alpha)


def _steady(case: int, exact: UnsteadyState, alpha: float) -> Scene:
    """Return the scene of a steady flow about an axis of rotation that is tilted by alpha [rad]."""
    return flows.build_scene(
        f"williamson{case}", effects=flows.ROTATING, exact=exact,
        coriolis=lambda lon, lat: 2.0 * EARTH.rotation * flows.sin_tilted_latitude(lon, lat, alpha),
    )  # fmt: skip


def williamson5(speed: float = 20.0) -> Scene:
    """Zonal flow over an isolated mountain.

    Case 5: the wind is u = u0 cos θ, and the surface over a cone of 2000 m is in balance with it:

        h + b = 5960 m - (a Ω u0 + u0²/2) sin² θ / g

    Errors of height are those of the free surface. The initial wind is not adjusted to the cone and
    radiates gravity waves of about 7e-4 of the height (relative l2); time steps longer than the
    period of these waves lose them. The recommended mesh is the coarsest on which rk4 reaches an
    error of 1e-4 at day 15; ne8 np8 reaches 4e-5.

    Args:
        speed: u0 [m s-1], 20 in the paper; gravity waves move at 240 m/s.
    """
    fall = (EARTH.radius * EARTH.rotation * speed + 0.5 * speed**2) / EARTH.gravity

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        depth = 5960.0 - fall * np.sin(lat) ** 2 - flows.cone(lon, lat)
        return speed * np.cos(lat), 0.0 * lat, depth

    return flows.build_scene(
        "williamson5", effects=(*flows.ROTATING, Orography()), initial=initial, bottom=flows.cone,
        error_field="surface", sheds_waves=True,
    )  # fmt: skip


def williamson6(perturbation: float = 0.0, omega: float = 7.848e-6, depth: float = 8000.0) -> Scene:
    """Rossby-Haurwitz wave of zonal wavenumber 4.

    Case 6. The wave moves eastward by about 12 degrees a day and keeps its shape until truncation
    errors or the physical instability break it.

    Args:
        perturbation: size δ [m] of a disturbance δ/3 Σ cos^m θ cos(m λ + m), m = 1, 2, 3, of the
            depth, which makes the breakdown independent of round-off and mesh. With 1 m the wave
            breaks at about day 21 (the instability is that of Thuburn & Li 2000).
        omega: strength ω = K of the flow [s-1]; the largest wind is proportional to ω.
        depth: h0 [m], the depth at the poles. With growing depth the flow becomes nondivergent,
            and the wave speed approaches (28 ω - 2 Ω) / 30, which is 12.195 degrees a day.
    """

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        r, a, k, rotation = 4, EARTH.radius, omega, EARTH.rotation
        c, s = np.cos(lat), np.sin(lat)
        u = a * k * (c + c ** (r - 1) * (r * s**2 - c**2) * np.cos(r * lon))
        v = -a * k * r * c ** (r - 1) * s * np.sin(r * lon)
        # the factor c⁻² of the paper is cancelled, so that all terms are finite at the poles
        zonal = 0.5 * k * (2.0 * rotation + k) * c**2 + 0.25 * k**2 * c ** (2 * r - 2) * (
            (r + 1) * c**4 + (2 * r**2 - r - 2) * c**2 - 2 * r**2
        )
        once = 2.0 * (rotation + k) * k / ((r + 1) * (r + 2)) * c**r
        once = once * ((r**2 + 2 * r + 2) - (r + 1) ** 2 * c**2)
        twice = 0.25 * k**2 * c ** (2 * r) * ((r + 1) * c**2 - (r + 2))
        wave = zonal + once * np.cos(r * lon) + twice * np.cos(2 * r * lon)
        h = depth + a**2 * wave / EARTH.gravity
        waves = (np.cos(lat) ** m * np.cos(m * lon + m) for m in (1, 2, 3))
        return u, v, h + perturbation / 3.0 * sum(waves) if perturbation else h

    effects = flows.ROTATING
    return flows.build_scene("williamson6", effects=effects, initial=initial, sheds_waves=True)


def williamson4(u0: float = 20.0) -> Scene:
    """Low carried along in a jet by a forcing (exact).

    Case 4. A low ψ moves in a jet ū = u0 sin¹⁴ 2θ that is in balance with the depth h̄:

        ψ = ψ0 exp(-σ (1 - C)/(1 + C)),  C the cosine of the distance from its centre,
        u = ū - ∂ψ/∂θ / a,  v = ∂ψ/∂λ / (a cos θ),  h = h̄ + f ψ / g

    with ψ0 = -0.03 · 1e5 m² s⁻² / (2 Ω sin θ₀) and σ = (2a / 1000 km)². The centre moves along θ₀ =
    45°N at the angular speed u0 / a. A forcing, evaluated at each stage, makes this flow exact.

    Args:
        u0: speed of the jets at 45°N and 45°S [m s-1]; 20 and 40 in the paper.
    """
    a, angular_speed = EARTH.radius, u0 / EARTH.radius

    def jet(lat: Array) -> Array:
        """Return ū [m s-1]."""
        return u0 * np.sin(2.0 * lat) ** 14

    drop = flows.zonal_balance(jet)

    def exact(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        c_lat, side, psi, once = _low(lon - u0 * t / a, lat)[1:5]
        geopotential = GEOPOTENTIAL - drop(lat) + EARTH.coriolis(lon, lat) * psi
        return jet(lat) + -once * c_lat / a, -once * side / a, geopotential / EARTH.gravity

    def forcing(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        """Return the residual of the equations for the exact flow [m s-2, m s-2, m s-1].

        The residual is zero, and not computed, far from the low. Derivatives are written out to
        avoid a division by the cosine of the latitude.
        """
        lon = lon - u0 * t / a
        there = _low(lon, lat)[0] > 0.4  # further off ψ is below 1e-30 of its central value
        found = np.zeros((3, *np.shape(there)))
        found[:, there] = rates(lon[there], lat[there])
        return found[0], found[1], found[2]

    def rates(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        c, c_lat, side, psi, once, twice = _low(lon, lat)
        around, sin, cos = np.cos(LOW_LATITUDE) * np.cos(lon), np.sin(lat), np.cos(lat)
        u, v = -once * c_lat / a, -once * side / a
        u_lon = side * (twice * cos * c_lat - once * sin) / a
        v_lon = (twice * cos * side**2 - once * around) / a
        u_lat = (once * c - twice * c_lat**2) / a**2
        v_lat = -twice * side * c_lat / a**2
        # (∂v/∂λ / cos θ + u tan θ) / a, with the terms infinite at the poles cancelled
        bend = (twice * side**2 - once * c) / a**2
        sin13, mean, two_omega_cos = np.sin(2.0 * lat) ** 13, jet(lat), 2.0 * EARTH.rotation * cos
        mean_tan = 2.0 * u0 * sin13 * sin**2  # ū tan θ: zero at the poles
        total, shear = mean + u, 28.0 * u0 * sin13 * np.cos(2.0 * lat) / a + u_lat
        east = -angular_speed * u_lon - total * v_lat + v * shear
        north = -angular_speed * v_lon + total * bend + v * v_lat
        north += (mean_tan * u + two_omega_cos * psi) / a
        pull = -u0 * EARTH.coriolis(lon, lat) * cos
        geopotential = v * (pull + (two_omega_cos * psi - mean * mean_tan) / a)
        return east, north, geopotential / EARTH.gravity

    effects = (*flows.ROTATING, Forcing())
    return flows.build_scene("williamson4", effects=effects, exact=exact, forcing=forcing)


def _low(lon: Array, lat: Array) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Return C, ∂C/∂θ, -∂C/∂λ / cos θ, ψ, dψ/dC and d²ψ/dC² of the low of case 4.

    lon: longitude minus that of the centre of the low [rad].
    """
    sin, cos = np.sin(lat), np.cos(lat)
    around, side = np.cos(LOW_LATITUDE) * np.cos(lon), np.cos(LOW_LATITUDE) * np.sin(lon)
    c = np.sin(LOW_LATITUDE) * sin + np.cos(LOW_LATITUDE) * cos * np.cos(lon)
    near = np.maximum(1.0 + c, 1e-9)  # zero at the antipode of the centre
    psi = STRENGTH * np.exp(-SHARPNESS * (1.0 - c) / near)
    once = 2.0 * SHARPNESS * psi / near**2
    twice = 4.0 * SHARPNESS * psi * (SHARPNESS - near) / near**4
    return c, np.sin(LOW_LATITUDE) * cos - around * sin, side, psi, once, twice


def mcdonald_bates() -> Scene:
    """Cross-polar flow in geostrophic balance.

    Winds of 20 m/s blow straight over both poles:

        g h = g h0 + 2 Ω a v0 sin³ θ cos θ sin λ,  g h0 = 5.768e4 m² s⁻²
        u = -v0 sin λ sin θ (4 cos² θ - 1),  v = v0 cos λ sin² θ

    No exact solution is known. The flow keeps the symmetry λ → λ + π, θ → -θ with v → -v
    (reflection at the planet's centre), which is also a symmetry of the cubed sphere.
    """
    speed = 20.0

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        sin, cos = np.sin(lat), np.cos(lat)
        u = -speed * np.sin(lon) * sin * (4.0 * cos**2 - 1.0)
        swell = 2.0 * EARTH.rotation * EARTH.radius * speed * sin**3 * cos * np.sin(lon)
        return u, speed * sin**2 * np.cos(lon), (5.768e4 + swell) / EARTH.gravity

    return flows.build_scene("mcdonald-bates", effects=flows.ROTATING, initial=initial)
