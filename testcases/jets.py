"""Jets: barotropically unstable jets, and exact unsteady flows about a tilted axis.

The exact flows (`lauter`, `tilted_jet`) are steady in an inertial frame; seen from the rotating
planet their pattern rotates once a day.
"""

from dataclasses import replace

import numpy as np

from swe_sphere.equations.effects import Hyperviscosity, Orography, Relaxation
from swe_sphere.equations.scene import Array, Scene
from swe_sphere.errors import ConfigError
from swe_sphere.planet import DAY, EARTH
from swe_sphere.testcases import flows
from swe_sphere.testcases.harmonics import BalancedFlow, random_streamfunction
from swe_sphere.testcases.williamson import SPEED

JET = flows.ZonalJet(speed=80.0, south=np.pi / 7.0, north=np.pi / 2.0 - np.pi / 7.0)
"""The jet at 45°N of Galewsky et al. (2004), eq. 2."""


def galewsky(
    perturbed: bool = True, speed: float = 80.0, seed: int = 0, noise: float = 0.1
) -> Scene:
    """Barotropically unstable jet at 45°N, set off by a bump of 120 m.

    With u(θ) = 80 m/s exp(4/(θ1-θ0)²) exp(1/((θ-θ0)(θ-θ1))) between θ0 = π/7 and θ1 = π/2 - θ0,

        g h = g h00 - ∫ a u (f + u tan θ / a) dθ  (+ g 120 m cos θ exp(-(3λ)²) exp(-(15(π/4-θ))²))

    with h00 = 10158 m. The bump raises the mean depth from 10 km by 1/3 m. The paper also shows a
    viscous case (`--set viscosity.nu=1e5`). Inviscid vorticity does not converge after day 4.

    Args:
        perturbed: add the bump. Without the bump the flow is steady (exact), so that all growth
            comes from the imprint of the grid.
        speed: speed of the jet [m s-1], 80 in the paper; a stronger jet lowers the mean depth.
        seed: seed of random winds in linear balance, with the same energy at each degree of the
            spherical harmonics from 2 to 20, for the members of an ensemble; 0 for no such winds.
        noise: root mean square of the random winds [m s-1].
    """
    jet = replace(JET, speed=speed)
    found = random_streamfunction(np.ones_like, 20, noise, EARTH.radius, seed)
    random = BalancedFlow(found, EARTH, 0.0, linear=True)

    def flow(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        # at 80 m/s the mean depth is 10 km
        depth = 10158.18617045462 - jet.drop(lat) / EARTH.gravity
        return jet(lat) + 0.0 * lon, 0.0 * (lon + lat), depth + 0.0 * lon

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        u, v, depth = flow(lon, lat, 0.0)
        if seed:
            du, dv, dh = random.state(lon, lat)
            u, v, depth = u + du, v + dv, depth + dh
        return u, v, depth + bump(lon, lat) if perturbed else depth

    exact = None if perturbed or seed else flow
    return flows.build_scene("galewsky", effects=flows.ROTATING, initial=initial, exact=exact)


def bump(lon: Array, lat: Array) -> Array:
    """Return the initial perturbation of the depth [m] (Galewsky et al. 2004, eq. 4)."""
    across = np.exp(-((3.0 * flows.wrapped(lon)) ** 2))
    h: Array = 120.0 * np.cos(lat) * across * np.exp(-((15.0 * (np.pi / 4.0 - lat)) ** 2))
    return h


def relaxed_jet(time: float = 10.0, perturbed: bool = True) -> Scene:
    """Barotropically unstable jet whose depth is relaxed to that of the steady jet.

    The jet of Galewsky et al. (2004) and its bump, with

        ∂h/∂t = … - (h - h_eq) / τ,  h_eq in balance with the jet.

    After a week the jet has rolled up into vortices. The relaxation rebuilds the slope of the
    depth, and at day 20 four waves run along the jet. The area mean of the depth is known exactly:
    its excess over the mean of h_eq is 1/3 m × exp(-t / τ). Hyperviscosity of 30 times the default
    coefficient of the mesh removes grid-scale enstrophy.

    Args:
        time: τ [days].
        perturbed: add the bump. Without it the jet is steady except for hyperviscosity.

    Raises ConfigError for a time that is not positive and finite.
    """
    if not 0.0 < time < np.inf:
        raise ConfigError(f"relaxed-jet: time must be positive and finite, got {time}")
    steady = galewsky(perturbed=False).initial
    return flows.build_scene(
        "relaxed-jet", initial=galewsky(perturbed).initial,
        effects=(*flows.ROTATING, Relaxation(time * DAY), Hyperviscosity(factor=30.0)),
        equilibrium=lambda lon, lat: steady(lon, lat)[2],
    )  # fmt: skip


EQUATOR_SPEED = EARTH.rotation * EARTH.radius
"""Speed of the planet at its equator [m s-1]."""
BOTTOM_GEOPOTENTIAL = 10.0
"""The constant k2 in g b of `bottom` [m2 s-2]."""


def lauter(alpha: float = np.pi / 4.0) -> Scene:
    """Unsteady nonlinear flow over orography (exact).

    The flow is smooth, fast and exact, and therefore serves to rank time integrators.

    The flow is a solid-body rotation about an axis tilted by α and fixed in an inertial frame. With
    S the sine of the latitude relative to this axis, at the inertial longitude λ + Ω t,

        g (h + b) = k1 + (Ω a sin θ)²/2 - (u0 S + Ω a sin θ)²/2,  g b = (Ω a sin θ)²/2 + k2

    with u0 = 2 π a / 12 days, k1 = 133681 m² s⁻² and k2 = 10 m² s⁻². For α = π/4 the depth is 1256
    to 13631 m over a bottom of up to 11 km. The period is 2 π / Ω = 86165 s.

    Args:
        alpha: tilt of the flow's axis [rad]; the flow is steady for 0.
    """

    def exact(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        fixed = lon + EARTH.rotation * t
        turning = EQUATOR_SPEED * np.sin(lat)
        total = SPEED * flows.sin_tilted_latitude(fixed, lat, alpha) + turning
        surface = (133681.0 + 0.5 * turning**2 - 0.5 * total**2) / EARTH.gravity
        return *flows.solid_body(fixed, lat, alpha, SPEED), surface - bottom(lon, lat)

    effects = (*flows.ROTATING, Orography())
    return flows.build_scene("lauter", effects=effects, exact=exact, bottom=bottom)


def bottom(lon: Array, lat: Array) -> Array:
    """Return the height [m] of a bottom that compensates for the flattening of the planet."""
    geopotential = 0.5 * (EQUATOR_SPEED * np.sin(lat)) ** 2 + BOTTOM_GEOPOTENTIAL
    return geopotential / EARTH.gravity + 0.0 * lon


def tilted_jet(alpha: float = 0.08, speed: float = 40.0, gaussian: bool = False) -> Scene:
    """Unsteady jet about a tilted axis, over orography (exact).

    In an inertial frame the wind is U = (Ω a + F(S)) cos θ' about an axis tilted by α against the
    planet's, with θ' the latitude relative to this axis and S = sin θ'. With the bottom of `lauter`
    the flow is steady in that frame if g h = 160000 m² s⁻² - ∫ (Ω a + F)² S dS, from S = 0. Seen
    from the planet the pattern rotates once a day.

    Args:
        alpha: tilt of the axis of the flow [rad]; the flow is steady for 0.
        speed: largest wind F cos θ' of the jet [m s-1]; the Gaussian jet exceeds it by 2 %.
        gaussian: F is a Gaussian about 45°N; otherwise F is proportional to S².

    Raises ConfigError if the depth is not positive everywhere.
    """

    def jet(s: Array) -> Array:
        """Return Ω a + F(S) [m s-1]."""
        shape = 1.5 * np.sqrt(3.0) * s**2
        if gaussian:
            shape = np.exp(-(((s - np.sin(np.pi / 4.0)) / 0.2) ** 2)) / np.cos(np.pi / 4.0)
        return np.asarray(EQUATOR_SPEED + speed * shape)

    points, weights = np.polynomial.legendre.leggauss(64)  # exact to round-off

    def depth(s: Array) -> Array:
        """Return the depth h(S) [m]."""
        sines = 0.5 * np.asarray(s)[..., None] * (1.0 + points)
        fall: Array = 0.5 * s * ((jet(sines) ** 2 * sines) @ weights)
        return (160000.0 - fall) / EARTH.gravity

    if not depth(np.array([-1.0, 1.0])).min() > 0.0:
        raise ConfigError(f"tilted-jet: a jet of {speed} m/s drains the pole: reduce it")

    def exact(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        fixed = lon + EARTH.rotation * t
        east, north = flows.solid_body(fixed, lat, alpha)
        sine = flows.sin_tilted_latitude(fixed, lat, alpha)
        flow = jet(sine)
        return flow * east - EQUATOR_SPEED * np.cos(lat), flow * north, depth(sine)

    effects = (*flows.ROTATING, Orography())
    return flows.build_scene("tilted-jet", effects=effects, exact=exact, bottom=bottom)
