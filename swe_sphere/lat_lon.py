"""Smooth interpolation from latitude-longitude grids that go round the globe."""

from collections.abc import Callable

import numpy as np

from swe_sphere.arrays import Array

RIM = 8
"""Rows and columns repeated beyond the poles and around, so that the spline knows no edges."""


def global_spline(
    lat: Array, lon: Array, field: Array, degree: int, sign: float = 1.0
) -> Callable[[Array, Array], Array]:
    """The spline of a degree through a field (M, K), as a function of longitude and latitude [rad].

    lat (M,) [rad], in any order; lon (K,) [rad], evenly eastward once around, K even.  Over a pole
    the field goes on along the opposite meridian, where east and north are turned about: sign is
    -1 for the components of a vector.
    """
    from scipy.interpolate import RectBivariateSpline

    order = np.argsort(lat)
    lat, field = lat[order], field[order]
    inside = np.abs(lat) < np.pi / 2.0 - 1e-9  # a row at the pole itself is not repeated
    opposite, near = sign * np.roll(field, lon.size // 2, axis=1)[inside], lat[inside]
    y = np.concatenate([-np.pi - near[RIM - 1 :: -1], lat, np.pi - near[: -RIM - 1 : -1]])
    rows = np.concatenate([opposite[RIM - 1 :: -1], field, opposite[: -RIM - 1 : -1]])
    x = 2.0 * np.pi / lon.size * np.arange(-RIM, lon.size + RIM)
    grid = np.concatenate([rows[:, -RIM:], rows, rows[:, :RIM]], axis=1)
    spline = RectBivariateSpline(y, x, grid, kx=degree, ky=degree)

    def evaluate(at_lon: Array, at_lat: Array) -> Array:
        found: Array = spline.ev(at_lat, (at_lon - lon[0]) % (2.0 * np.pi))
        return found

    return evaluate
