"""Longitude and latitude, their unit vectors, and splines over longitude-latitude grids."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from swe_sphere.arrays import Array


def position(lon: ArrayLike, lat: ArrayLike) -> Array:
    """Return unit vectors (..., 3) of longitudes and latitudes [rad], broadcast together."""
    lon, lat = np.broadcast_arrays(lon, lat)
    return np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1)


def angle(point: Array, other: Array) -> Array:
    """Return the angle [rad] between unit vectors (..., 3), accurate near 0 and pi too."""
    apart, along = (np.linalg.norm(x, axis=-1) for x in (point - other, point + other))
    return np.asarray(2.0 * np.arctan2(apart, along))


def frame(lon: Array, lat: Array) -> tuple[Array, Array]:
    """Return unit vectors (east, north), each (..., 3), at longitudes and latitudes [rad].

    At the poles both vectors depend on the longitude passed.
    """
    east = np.stack([-np.sin(lon), np.cos(lon), np.zeros_like(lon)], axis=-1)
    north = np.stack([-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)], axis=-1)
    return east, north


def snap_poles(xyz: Array) -> Array:
    """Return unit vectors (..., 3) with points within round-off of a pole moved to the pole."""
    at_pole = np.hypot(xyz[..., :1], xyz[..., 1:2]) < 1e-14
    return np.where(at_pole, np.rint(xyz) + 0.0, xyz)  # adding 0.0 turns -0.0 into 0.0


def longitude_latitude(xyz: Array) -> tuple[Array, Array]:
    """Return longitude in [0, 2 pi), 0 at poles, and latitude [rad] of unit vectors (..., 3)."""
    x, y, z = np.moveaxis(xyz, -1, 0)
    lon = np.arctan2(y, x)
    lon = np.where(lon < 0.0, lon + 2.0 * np.pi, lon)
    # a tiny negative longitude rounds up to 2 pi itself; adding 0.0 turns -0.0 into 0.0
    lon = np.where((lon >= 2.0 * np.pi) | ((x == 0.0) & (y == 0.0)), 0.0, lon) + 0.0
    return lon, np.arctan2(z, np.hypot(x, y))


RIM = 8
"""Number of rows and columns repeated beyond each side, so that the spline has no edges."""


def global_spline(
    lat: Array, lon: Array, field: Array, degree: int, sign: float = 1.0
) -> Callable[[Array, Array], Array]:
    """Return a function (longitude, latitude) [rad] that evaluates the spline of a field (M, K).

    lat (M,) [rad], in any order; lon (K,) [rad], ascending, evenly spaced over 2 pi, K even. Beyond
    a pole the field continues along the opposite meridian, where east and north point the other
    way: sign is -1 for the components of a vector.
    """
    from scipy.interpolate import RectBivariateSpline

    order = np.argsort(lat)
    lat, field = lat[order], field[order]
    inside = np.abs(lat) < np.pi / 2.0 - 1e-9  # a row at the pole itself is not repeated
    opposite, near = sign * np.roll(field, lon.size // 2, axis=1)[inside], lat[inside]
    y = np.concatenate([-np.pi - near[RIM - 1 :: -1], lat, np.pi - near[: -RIM - 1 : -1]])
    rows = np.concatenate([opposite[RIM - 1 :: -1], field, opposite[: -RIM - 1 : -1]])
    x = 2.0 * np.pi / lon.size * np.arange(-RIM, lon.size + RIM)
    grid = np.take(rows, range(-RIM, lon.size + RIM), axis=1, mode="wrap")
    spline = RectBivariateSpline(y, x, grid, kx=min(degree, y.size - 1), ky=degree)
    return lambda at_lon, at_lat: spline.ev(at_lat, (at_lon - lon[0]) % (2.0 * np.pi))
