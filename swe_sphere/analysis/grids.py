"""Grids of latitudes and longitudes that go round the globe, by name.

`latlon:181x360` has 181 rows and 360 columns, both evenly spaced.  An odd number of rows puts the
first and the last on the poles, where their cells are half as high; an even number puts all in the
middle of equal cells.  `gaussian:N` has the 2N Gauss latitudes and 4N longitudes.  Longitudes
begin at 0 and go east, latitudes from south to north.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError, shown
from swe_sphere.settings.values import convert

MOST_POINTS = 2**28
"""No grid has more points than this: a field of them takes 2 GiB."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Points at all pairs of latitudes (M,) and longitudes (K,) [rad], and the cells around them.

    edges (M+1,) [rad]: latitudes of the southern and northern edges of the cells; their areas are
    the weights that integrate over the sphere.
    """

    name: str
    lat: Array
    lon: Array
    edges: Array

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of latitudes and longitudes (M, K)."""
        return self.lat.size, self.lon.size

    @property
    def zones(self) -> Array:
        """Share (M,) of the sphere's area that each row of cells has."""
        return np.asarray(0.5 * np.diff(np.sin(self.edges)), dtype=np.float64)

    @property
    def lon_edges(self) -> Array:
        """Longitudes (K+1,) [rad] of the western and eastern edges of the cells."""
        west = -0.5 * float(self.lon[1])
        return np.linspace(west, west + 2.0 * np.pi, self.lon.size + 1)

    @property
    def points(self) -> tuple[Array, Array]:
        """Longitude and latitude (M, K) [rad] of all points."""
        lon, lat = np.meshgrid(self.lon, self.lat)
        return lon, lat


def parse_grid(text: str) -> Grid:
    """The grid of that name: latlon:ROWSxCOLUMNS or gaussian:N.

    Raises ConfigError for another text, or numbers too small or large.
    """
    if found := re.fullmatch(r"latlon:(\d+)x(\d+)", text):
        return lat_lon(*map(int, found.groups()))
    if found := re.fullmatch(r"gaussian:(\d+)", text):
        return gaussian(int(found[1]))
    raise ConfigError(
        f"there is no grid {shown(text)}: say latlon:ROWSxCOLUMNS (latlon:181x360) or gaussian:N"
        " (2N latitudes, 4N longitudes)"
    )


def lat_lon(rows: int, columns: int) -> Grid:
    """Even latitudes and longitudes; ConfigError for less than 2 rows or 4 columns."""
    rows, columns = convert("rows", int, rows), convert("columns", int, columns)
    _check(f"latlon:{rows}x{columns}", rows, columns)
    if rows % 2:
        lat = np.linspace(-0.5 * np.pi, 0.5 * np.pi, rows)
        edges = np.concatenate([lat[:1], 0.5 * (lat[1:] + lat[:-1]), lat[-1:]])
    else:
        edges = np.linspace(-0.5 * np.pi, 0.5 * np.pi, rows + 1)
        lat = 0.5 * (edges[1:] + edges[:-1])
    return Grid(f"latlon:{rows}x{columns}", lat, _around(columns), edges)


def gaussian(n: int) -> Grid:
    """The 2n Gauss latitudes and 4n longitudes; ConfigError for n < 1.

    The cells are as high as the Gauss weights say, so that sums over them are Gauss quadrature.
    """
    n = convert("n", int, n)
    _check(f"gaussian:{n}", 2 * n, 4 * n)
    sines, weights = np.polynomial.legendre.leggauss(2 * n)
    edges = np.arcsin(np.clip(np.concatenate([[-1.0], np.cumsum(weights) - 1.0]), -1.0, 1.0))
    edges[-1] = 0.5 * np.pi
    return Grid(f"gaussian:{n}", np.arcsin(sines), _around(4 * n), edges)


def _around(columns: int) -> Array:
    return np.arange(columns, dtype=np.float64) * (2.0 * np.pi / columns)


def _check(name: str, rows: int, columns: int) -> None:
    if rows < 2 or columns < 4:
        raise ConfigError(f"the grid {name} is too small: at least 2 latitudes and 4 longitudes")
    if rows * columns > MOST_POINTS:
        raise ConfigError(f"the grid {name} is too large: at most {MOST_POINTS} points")
