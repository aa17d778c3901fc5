"""Scenes of use for verification only: with exact solutions, or as another model has them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from swe_sphere.equations.effects import (
    DYNAMICS,
    Drag,
    Forcing,
    Hyperviscosity,
    Relaxation,
    Viscosity,
)
from swe_sphere.equations.scene import Array, Scene, UnsteadyState
from swe_sphere.planet import DAY, EARTH
from swe_sphere.testcases import get_scene
from swe_sphere.testcases.flows import solid_body, tilted_latitude

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
        name, title, reference, initial=lambda lon, lat: exact(lon, lat, 0.0), exact=exact,
        report="l2 of h and of the wind", ne=4, np=4, dt=None, days=1.0, **values,
    )  # fmt: skip


def _harmonic(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
    """Y = x³ - 3 x y² + 15 x y z, and a times its gradient eastward and northward."""
    c, s = np.cos(lat), np.sin(lat)
    value = c**3 * np.cos(3.0 * lon) + 7.5 * s * c**2 * np.sin(2.0 * lon)
    east = -3.0 * c**2 * np.sin(3.0 * lon) + 15.0 * s * c * np.cos(2.0 * lon)
    north = -3.0 * c**2 * s * np.cos(3.0 * lon) + 7.5 * (c**3 - 2.0 * s**2 * c) * np.sin(2.0 * lon)
    return value, east, north


SCENES = {
    "decay": decay,
    "friction": friction,
    "driven": driven,
    "homme-mountain": homme_mountain,
    "homme-wave": homme_wave,
}
"""By the names in files of cases; their keyword parameters are those of the scene."""
