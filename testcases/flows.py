"""Formulas that several scenes share: tilted and zonal flow, distances, the conical mountain.

Points are given by longitude and latitude [rad]. All formulas are finite and smooth at the poles
and at the longitude where angles wrap around.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from swe_sphere.equations.effects import DYNAMICS, Rotation
from swe_sphere.equations.scene import Array, Scene, State, UnsteadyState
from swe_sphere.mesh.sphere import angle, position
from swe_sphere.planet import DAY, EARTH
from swe_sphere.settings.values import read_toml

ENTRIES = read_toml(Path(__file__).with_name("scenes.toml"))
"""Title, reference, recommended mesh and recommended run length of each scene, by name."""
ROTATING = (*DYNAMICS, Rotation())
"""Effects of a flow on a rotating planet without orography."""
PERIOD = 12.0 * DAY
"""Period of solid-body flows, and of the deformational flow and its reversal [s]."""
ANGULAR_SPEED = 2.0 * np.pi / PERIOD
"""Angular speed of solid-body flows [s-1]."""


def build_scene(name: str, exact: UnsteadyState | None = None, **fields: Any) -> Scene:
    """Return the scene `name` with its entries in scenes.toml; `fields` add to or replace them.

    The initial state is `exact` at t = 0, unless `fields` contain `initial`.
    """
    initial = {} if exact is None else {"initial": lambda lon, lat: exact(lon, lat, 0.0)}
    return Scene(name, exact=exact, **ENTRIES[name] | initial | fields)


def at_rest(depth: float) -> State:
    """Return a state without wind and with the same depth [m] everywhere."""
    return lambda lon, lat: (0.0 * lon, 0.0 * lat, depth + 0.0 * lat)


def sin_tilted_latitude(lon: Array, lat: Array, alpha: float) -> Array:
    """Return the sine of the latitude relative to the axis (-sin α, 0, cos α); α [rad]."""
    return np.asarray(np.sin(lat) * np.cos(alpha) - np.cos(lat) * np.cos(lon) * np.sin(alpha))


def solid_body(lon: Array, lat: Array, alpha: float, speed: float = 1.0) -> tuple[Array, Array]:
    """Return the eastward and northward components of c × n at the unit vectors n of points.

    With c = `speed` (-sin α, 0, cos α) this is the wind of a solid-body rotation (Williamson et al.
    1992, cases 1 and 2), which is `speed` times the cosine of the tilted latitude.
    """
    east = np.cos(lat) * np.cos(alpha) + np.sin(lat) * np.cos(lon) * np.sin(alpha)
    return speed * east, speed * (-np.sin(lon) * np.sin(alpha) + 0.0 * lat)


def turned(point: Array, alpha: float, turn: float) -> Array:
    """Return unit vectors (..., 3) rotated by `turn` [rad] about (-sin α, 0, cos α); α [rad]."""
    axis = np.array([-np.sin(alpha), 0.0, np.cos(alpha)])
    along = (point @ axis)[..., np.newaxis] * axis
    along = along * (1.0 - np.cos(turn))  # Rodrigues' formula
    return np.asarray(point * np.cos(turn) + np.cross(axis, point) * np.sin(turn) + along)


def wrapped(angle: Array) -> Array:
    """Return an angle shifted by multiples of 2π into [-π, π)."""
    return np.mod(angle + np.pi, 2.0 * np.pi) - np.pi


def distance(lon: Array, lat: Array, lon0: float, lat0: float) -> Array:
    """Angle [rad] between points and the point (lon0, lat0)."""
    return angle(position(lon, lat), position(lon0, lat0))


def cone(lon: Array, lat: Array) -> Array:
    """Height [m] of the mountain of Williamson et al. (1992), case 5: a 2000 m cone at (3π/2, π/6).

    Its radius of π/9 is measured in the longitude-latitude plane, not along great circles.
    """
    radius = np.pi / 9.0
    distance = np.hypot(wrapped(lon - 1.5 * np.pi), lat - np.pi / 6.0)
    return 2000.0 * (1.0 - np.minimum(distance, radius) / radius)


def zonal_balance(
    wind: Callable[[Array], Array], south: float = -np.pi / 2.0, north: float = np.pi / 2.0
) -> Callable[[Array], Array]:
    """Return the function of latitude [rad] that gives the fall of g h [m2 s-2] from 90°S.

    A steady zonal wind u on `EARTH` is balanced by g ∂h/∂θ = -a u (f + u tan θ / a) (Williamson et
    al. 1992, eq. 101; Galewsky et al. 2004, eq. 3).

    wind: function of latitude [rad] that returns u [m s-1], smooth where u is not zero. south,
    north: latitudes [rad] outside of which u is zero.
    """
    # 128 Gauss-Legendre panels of 8 points: the integrals are right to round-off
    points, weights = np.polynomial.legendre.leggauss(8)

    def integral(start: Array, end: Array) -> Array:
        """Return the integrals of a u (f + u tan θ / a) [m2 s-2] from `start` to `end` [rad]."""
        half = 0.5 * (end - start)
        lat = 0.5 * (start + end)[..., None] + half[..., None] * points
        u, coriolis = wind(lat), 2.0 * EARTH.rotation * np.sin(lat)
        return half * ((u * (EARTH.radius * coriolis + u * np.tan(lat))) @ weights)

    edges = np.linspace(south, north, 129)
    totals = np.concatenate([[0.0], np.cumsum(integral(edges[:-1], edges[1:]))])

    def drop(lat: Array | float) -> Array:
        lat = np.asarray(lat, dtype=np.float64)
        fall = np.where(lat >= north, totals[-1], 0.0)
        inside = (lat > south) & (lat < north)
        panel = np.searchsorted(edges, lat[inside], side="right") - 1
        fall[inside] = totals[panel] + integral(edges[panel], lat[inside])
        return fall

    return drop


@dataclass(frozen=True)
class ZonalJet:
    """Zonal wind between two latitudes, infinitely smooth but not analytic at these latitudes.

    u(θ) = u0 exp(s (4/w² - 1/((θ - θ0)(θ1 - θ)))) for θ0 < θ < θ1, w = θ1 - θ0; zero elsewhere.

    speed: u0 [m s-1], the largest wind (halfway); south, north: θ0, θ1 [rad]; sharpness: s [rad2].
    """

    speed: float
    south: float
    north: float
    sharpness: float = 1.0

    def __call__(self, lat: Array) -> Array:
        """Wind [m s-1] at latitudes [rad]."""
        inside = (lat > self.south) & (lat < self.north)
        within = np.where(inside, (lat - self.south) * (self.north - lat), 1.0)
        shape = np.exp(self.sharpness * (4.0 / (self.north - self.south) ** 2 - 1.0 / within))
        return np.where(inside, self.speed * shape, 0.0)

    @cached_property
    def drop(self) -> Callable[[Array], Array]:
        """Decrease of g h from the south pole to a latitude, in balance with the wind [m2 s-2]."""
        return zonal_balance(self, self.south, self.north)
