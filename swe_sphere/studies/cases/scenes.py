"""Scenes of cases only: exact solutions, set-ups of another model, states hard to survive."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from swe_sphere.equations.effects import (
    DYNAMICS,
    Drag,
    Forcing,
    Hyperviscosity,
    Relaxation,
    Rotation,
    Viscosity,
)
from swe_sphere.equations.scene import Array, Scalar, Scene, UnsteadyState
from swe_sphere.planet import DAY, EARTH, Planet
from swe_sphere.studies.cases.random_state import noise, random_scene
from swe_sphere.testcases import get_scene
from swe_sphere.testcases.flows import cone, distance, solid_body, tilted_latitude
from swe_sphere.testcases.random_flow import BalancedFlow, random_streamfunction

DEGREE = 3
"""Of the spherical harmonic Y = cos³ θ cos 3λ + ... that decays."""
MEAN = 1000.0


def decay(nu: float = 0.0, nu4: float = 0.0, default: bool = False) -> Scene:
    """Spherical harmonics that viscosity and hyperviscosity let decay (exact).

    With Y of degree l = 3, depth 1000 m + 100 m Y and wind 10 m/s a (grad Y + k x grad Y) obey
    d/dt = -(nu k² + nu4 k⁴) with k² = l (l + 1)/a²; the Laplacian of the wind is Hodge's, whose
    eigenvalue on gradients and curls of Y is the same.

    Args:
        nu: viscosity [m2 s-1].
        nu4: hyperviscosity [m4 s-1].
        default: leave the hyperviscosity of the model to its scaling with the mesh, so that the
            error tells whether that is nu4.
    """
    wavenumber = DEGREE * (DEGREE + 1) / EARTH.radius**2
    rate = nu * wavenumber + nu4 * wavenumber**2

    def exact(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        value, east, north = _harmonic(lon, lat)
        left = np.exp(-rate * t)
        wind = 10.0 * left
        return wind * (east - north), wind * (east + north), MEAN + 100.0 * left * value

    diffusion = (Viscosity(nu), Hyperviscosity(None if default else nu4))
    return _exact_scene(
        "decay",
        "decay of spherical harmonics",
        "eigenfunctions of the Laplacian",
        exact,
        effects=tuple(effect for effect in diffusion if not effect.absent),
    )


def friction(linear: float, quadratic: float, time: float) -> Scene:
    """Drag and relaxation alone, node by node (exact).

    The wind follows d|v|/dt = -r |v| - c |v|², so |v| = r s / ((r + c s) exp(r t) - c s) with s its
    start; the depth nears its equilibrium exponentially.

    Args:
        linear: r [s-1].
        quadratic: c [m-1].
        time: of the relaxation [s].
    """

    def equilibrium(lon: Array, lat: Array) -> Array:
        return MEAN + 100.0 * np.sin(lat) + 0.0 * lon

    def exact(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        value, east, north = _harmonic(lon, lat)
        wind = 10.0 * np.stack([east, north])
        first = np.hypot(*wind)
        slower = linear / ((linear + quadratic * first) * np.exp(linear * t) - quadratic * first)
        rest = equilibrium(lon, lat)
        depth = rest + (MEAN + 100.0 * value - rest) * np.exp(-t / time)
        return slower * wind[0], slower * wind[1], depth

    return _exact_scene(
        "friction",
        "drag and relaxation",
        "Bernoulli's differential equation",
        exact,
        effects=(Drag(linear, quadratic), Relaxation(time)),
        equilibrium=equilibrium,
    )


SPEED = 40.0
"""Of the driven flow at its equator [m s-1]."""
DEPTH = 3000.0
DROP = 1000.0
"""By which the driven flow is shallower at its poles at the start [m]."""
GROWTH = 5.0 * DAY
"""Time in which its depth doubles [s]."""


def driven(alpha: float = np.pi / 4.0) -> Scene:
    """Solid-body flow that a forcing of wind and depth keeps up, all of it of first order (exact).

    Without rotation of the planet. With s the sine of the latitude above the equator of the flow,

        h = (3000 m - 1000 m s²) (1 + t/T),
        Fh = h(0)/T,  Fv = (u0² - 2 g 1000 m (1 + t/T)) s grad s / a,

    keep the wind as it is; grad is that of the unit sphere.

    Args:
        alpha: tilt of the flow's axis [rad].
    """

    def exact(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        east, north = solid_body(lon, lat, alpha)
        return SPEED * east, SPEED * north, _depth(lon, lat) * (1.0 + t / GROWTH)

    def _depth(lon: Array, lat: Array) -> Array:
        depth: Array = DEPTH - DROP * tilted_latitude(lon, lat, alpha) ** 2
        return depth

    def forcing(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        pull = SPEED**2 - 2.0 * EARTH.gravity * DROP * (1.0 + t / GROWTH)
        push = pull / EARTH.radius * tilted_latitude(lon, lat, alpha)
        east = np.sin(alpha) * np.sin(lon)
        north = np.sin(alpha) * np.sin(lat) * np.cos(lon) + np.cos(alpha) * np.cos(lat)
        return push * east, push * north, _depth(lon, lat) / GROWTH

    return _exact_scene(
        "driven",
        "solid-body flow kept up by a forcing",
        "williamson2 with a forcing in the place of rotation",
        exact,
        effects=(*DYNAMICS, Forcing()),
        forcing=forcing,
    )


HOMME = replace(EARTH, radius=6.376e6)
"""The planet of HOMME, which is 0.08 % larger than that of Williamson et al."""


def homme_mountain() -> Scene:
    """williamson5 on the planet of HOMME.

    The wind of u0 = 20 m/s is the same; its balance makes the surface fall by another
    (a - 6.37122e6 m) Ω u0 sin² θ / g.
    """
    scene = get_scene("williamson5")
    more = (HOMME.radius - EARTH.radius) * EARTH.rotation * 20.0 / EARTH.gravity

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        u, v, h = scene.initial(lon, lat)
        return u, v, h - more * np.sin(lat) ** 2

    return replace(scene, planet=HOMME, initial=initial)


def homme_wave() -> Scene:
    """williamson6 on the planet of HOMME.

    Its angular speeds are the same: the wind grows with the radius, and what the depth has beyond
    8000 m with its square.
    """
    scene = get_scene("williamson6")
    more = HOMME.radius / EARTH.radius

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        u, v, h = scene.initial(lon, lat)
        return more * u, more * v, 8000.0 + more**2 * (h - 8000.0)

    return replace(scene, planet=HOMME, initial=initial)


def _exact_scene(
    name: str, title: str, reference: str, exact: UnsteadyState, **values: Any
) -> Scene:
    """A scene that starts as its exact solution does, for a day."""
    return Scene(
        name, title=title, reference=reference, initial=lambda lon, lat: exact(lon, lat, 0.0),
        exact=exact, ne=4, days=1.0, **values,
    )  # fmt: skip


def _harmonic(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
    """Y = x³ - 3 x y² + 15 x y z, and a times its gradient eastward and northward."""
    c, s = np.cos(lat), np.sin(lat)
    value = c**3 * np.cos(3.0 * lon) + 7.5 * s * c**2 * np.sin(2.0 * lon)
    east = -3.0 * c**2 * np.sin(3.0 * lon) + 15.0 * s * c * np.cos(2.0 * lon)
    north = -3.0 * c**2 * s * np.cos(3.0 * lon) + 7.5 * (c**3 - 2.0 * s**2 * c) * np.sin(2.0 * lon)
    return value, east, north


# --- scenes that are hard to survive


PLACE = (1.5 * np.pi, np.pi / 6.0)
"""Where the mountain of williamson5 stands [rad]."""
RADIUS = np.pi / 9.0

PLANETS = {
    "mars": (Planet(3.3895e6, 3.71, 7.088e-5), 3000.0),
    "jupiter": (Planet(7.1492e7, 24.79, 1.7585e-4), 1.0e5),
    "venus": (Planet(6.0518e6, 8.87, -2.9924e-7), 3000.0),
    "still": (Planet(6.37122e6, 9.80616, 0.0), 3000.0),
}
"""Planets that are not the Earth, and the mean depth of their water here [m]."""


def mesa(lon: Array, lat: Array) -> Array:
    """A mountain with vertical sides: 2000 m within 20 degrees of its centre, else nothing."""
    return np.where(distance(lon, lat, *PLACE) < RADIUS, 2000.0, 0.0)


def _cone_of(height: float) -> Scalar:
    """The cone of williamson5, which is 2000 m high, with another height [m]."""
    return lambda lon, lat: height / 2000.0 * cone(lon, lat)


BOTTOMS: dict[str, Scalar] = {"mesa": mesa, "peak": _cone_of(5000.0), "island": _cone_of(7000.0)}
"""Bottoms by name: the peak is 960 m below the surface at rest, the island looks out of it."""

Bottom = Literal["mesa", "peak", "island"]


def lake_over(bottom: Bottom) -> Scene:
    """The lake at rest over another bottom."""
    lake: Scene = get_scene("lake-at-rest")
    mountain = BOTTOMS[bottom]

    def exact(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        still = 0.0 * (lon + lat)
        return still, still.copy(), 5960.0 - mountain(lon, lat)

    return replace(
        lake, initial=lambda lon, lat: exact(lon, lat, 0.0), exact=exact, bottom=mountain
    )


def flow_over(bottom: Bottom) -> Scene:
    """The flow of williamson5 over another bottom."""
    base: Scene = get_scene("williamson5")
    mountain = BOTTOMS[bottom]

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        u, v, h = base.initial(lon, lat)
        return u, v, h + cone(lon, lat) - mountain(lon, lat)

    return replace(base, initial=initial, bottom=mountain)


def noisy(name: str, wind: float = 1.0, depth: float = 10.0, seed: int = 1) -> Scene:
    """The scene with noise from node to node: rms of the winds [m s-1] and of the depth [m]."""
    base: Scene = get_scene(name)

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        u, v, h = base.initial(lon, lat)
        du, dv, dh = noise(lon.shape, seed)
        return u + wind * du, v + wind * dv, h + depth * dh

    return replace(base, initial=initial, exact=None)


def thin_layer(outside: float) -> Scene:
    """A dam of 1000 m that breaks onto water of another depth [m]."""
    base: Scene = get_scene("dam-break")

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        u, v, h = base.initial(lon, lat)
        return u, v, outside + (1000.0 - outside) * (h - 1000.0) / 1000.0

    return replace(base, initial=initial)


PlanetName = Literal["mars", "jupiter", "venus", "still"]


def zonal(name: PlanetName, speed: float = 40.0) -> Scene:
    """Steady zonal flow as in williamson2 on another planet (exact)."""
    planet, depth = PLANETS[name]
    fall = (planet.radius * planet.rotation * speed + 0.5 * speed**2) / planet.gravity

    def exact(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        h = depth + fall * (1.0 / 3.0 - np.sin(lat) ** 2)
        return speed * np.cos(lat) + 0.0 * lon, 0.0 * (lon + lat), h + 0.0 * lon

    return _on(planet, initial=lambda lon, lat: exact(lon, lat, 0.0), exact=exact)


def eddies(name: PlanetName, speed: float = 10.0) -> Scene:
    """A random balanced flow on another planet, without any dissipation."""
    planet, depth = PLANETS[name]
    psi = random_streamfunction(lambda n: 1.0 / n**2, 8, speed, planet.radius, seed=3)
    flow = BalancedFlow(psi, planet, depth)
    return _on(planet, initial=flow.state, exact=None, effects=(*DYNAMICS, Rotation()))


def _on(planet: Planet, **changes: Any) -> Scene:
    """williamson2 on another planet, with further changes."""
    base: Scene = get_scene("williamson2")
    return replace(base, planet=planet, coriolis=None, **changes)


SCENES: dict[str, Callable[..., Scene]] = {
    "decay": decay,
    "friction": friction,
    "driven": driven,
    "homme-mountain": homme_mountain,
    "homme-wave": homme_wave,
    "lake-over": lake_over,
    "flow-over": flow_over,
    "noisy": noisy,
    "thin-layer": thin_layer,
    "zonal": zonal,
    "eddies": eddies,
    "random-state": random_scene,
}
"""Scenes by the names in files of cases; their keyword parameters are those of the scene."""
