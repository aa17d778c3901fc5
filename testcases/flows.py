"""Formulas that several scenes share: flow about a tilted axis, distances, the conical mountain.

Points are given by longitude and latitude [rad]. Everything is written so that it is finite and
smooth at the poles and at the longitude where angles wrap around.
"""

from collections.abc import Callable

import numpy as np

from swe_sphere.equations.scene import Array
from swe_sphere.mesh.sphere import angle, position


def at_rest(depth: float) -> Callable[[Array, Array], tuple[Array, Array, Array]]:
    """No wind, and the same depth [m] everywhere."""
    return lambda lon, lat: (0.0 * lon, 0.0 * lat, depth + 0.0 * lat)


def tilted_latitude(lon: Array, lat: Array, alpha: float) -> Array:
    """Sine of the latitude above the equator of the axis c = (-sin α, 0, cos α)."""
    sine: Array = np.sin(lat) * np.cos(alpha) - np.cos(lat) * np.cos(lon) * np.sin(alpha)
    return sine


def solid_body(lon: Array, lat: Array, alpha: float) -> tuple[Array, Array]:
    """Eastward and northward component of c × n, c = (-sin α, 0, cos α), n the position.

    This is the solid-body wind of unit angular speed on the unit sphere (the wind of
    Williamson et al. 1992, cases 1 and 2); its length is the cosine of the tilted latitude.
    """
    east = np.cos(lat) * np.cos(alpha) + np.sin(lat) * np.cos(lon) * np.sin(alpha)
    return east, -np.sin(lon) * np.sin(alpha) + 0.0 * lat


def turned(point: Array, alpha: float, turn: float) -> Array:
    """Points (..., 3) turned by an angle [rad] about (-sin α, 0, cos α): Rodrigues' formula."""
    axis = np.array([-np.sin(alpha), 0.0, np.cos(alpha)])
    along = (point @ axis)[..., np.newaxis] * axis
    along = along * (1.0 - np.cos(turn))
    result: Array = point * np.cos(turn) + np.cross(axis, point) * np.sin(turn) + along
    return result


def wrapped(angle: Array) -> Array:
    """The angle brought into [-π, π)."""
    return np.mod(angle + np.pi, 2.0 * np.pi) - np.pi


def distance(lon: Array, lat: Array, lon0: float, lat0: float) -> Array:
    """Angle [rad] between points and the point (lon0, lat0)."""
    return angle(position(lon, lat), position(lon0, lat0))


def cone(lon: Array, lat: Array) -> Array:
    """The mountain of Williamson et al. (1992), case 5: a cone of 2000 m at (3π/2, π/6) [m].

    Its radius of π/9 is measured in the longitude-latitude plane, not along great circles.
    """
    radius = np.pi / 9.0
    distance = np.hypot(wrapped(lon - 1.5 * np.pi), lat - np.pi / 6.0)
    return 2000.0 * (1.0 - np.minimum(distance, radius) / radius)
