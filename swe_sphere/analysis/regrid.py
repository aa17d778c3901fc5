"""Fields of runs on global grids of latitudes and longitudes.

`latlon:181x360` has 181 rows and 360 columns, both evenly spaced. An odd number of rows puts the
first and the last on the poles, where their cells have half the height; an even number puts all in
the middle of equal cells. `gaussian:N` has the 2N Gauss latitudes and 4N longitudes. Longitudes
begin at 0 and go east, latitudes from south to north.
"""

import re
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError, shown
from swe_sphere.io.layout import TOPOLOGY, VARIABLES
from swe_sphere.mesh import Interpolator
from swe_sphere.settings.values import convert

MOST_POINTS = 2**28
"""Largest number of points of a grid: a field of this size takes 2 GiB."""


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
    def points(self) -> tuple[Array, Array]:
        """Longitude and latitude (M, K) [rad] of all points."""
        lon, lat = np.meshgrid(self.lon, self.lat)
        return lon, lat


def parse_grid(text: str) -> Grid:
    """Return the grid of that name: latlon:ROWSxCOLUMNS or gaussian:N.

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
    """Return even latitudes and longitudes; ConfigError for less than 2 rows or 4 columns."""
    rows, columns = convert("rows", int, rows), convert("columns", int, columns)
    lon = _around(name := f"latlon:{rows}x{columns}", rows, columns)
    if rows % 2:
        lat = np.linspace(-0.5 * np.pi, 0.5 * np.pi, rows)
        edges = np.concatenate([lat[:1], 0.5 * (lat[1:] + lat[:-1]), lat[-1:]])
    else:
        edges = np.linspace(-0.5 * np.pi, 0.5 * np.pi, rows + 1)
        lat = 0.5 * (edges[1:] + edges[:-1])
    return Grid(name, lat, lon, edges)


def gaussian(n: int) -> Grid:
    """Return the 2n Gauss latitudes and 4n longitudes; ConfigError for n < 1.

    The heights of cells follow from the Gauss weights, so that sums over them are Gauss quadrature.
    """
    n = convert("n", int, n)
    lon = _around(name := f"gaussian:{n}", 2 * n, 4 * n)
    sines, weights = np.polynomial.legendre.leggauss(2 * n)
    edges = np.arcsin(np.clip(np.concatenate([[-1.0], np.cumsum(weights) - 1.0]), -1.0, 1.0))
    edges[-1] = 0.5 * np.pi
    return Grid(name, np.arcsin(sines), lon, edges)


def _around(name: str, rows: int, columns: int) -> Array:
    """Return the longitudes of a grid; ConfigError if it is too small or too large."""
    if rows < 2 or columns < 4:
        raise ConfigError(f"the grid {name} is too small: at least 2 latitudes and 4 longitudes")
    if rows * columns > MOST_POINTS:
        raise ConfigError(f"the grid {name} is too large: at most {MOST_POINTS} points")
    return np.arange(columns, dtype=float) * (2.0 * np.pi / columns)


def on_grid(data: xr.Dataset, at: Interpolator, grid: Grid) -> xr.Dataset:
    """Return all fields on the nodes of a mesh at the points of a grid: (..., lat, lon)."""
    on_mesh = ("mesh", "location", "coordinates", "grid_mapping", "cell_measures")
    names = [name for name in fields_of(data) if name != "area"]
    sizes = {"lat": grid.lat.size, "lon": grid.lon.size}
    found: dict[str, xr.DataArray] = {}
    if {"u", "v"} & set(names):
        found["u"], found["v"] = on_nodes(at.wind, sizes, *holding(data, "u", "v"), results=2)
    for name in names:
        if name not in found:
            found[name] = on_nodes(at, sizes, data[name])
        found[name].attrs = {k: x for k, x in data[name].attrs.items() if k not in on_mesh}
    attributes = data.attrs | {"Conventions": "CF-1.11", "grid": grid.name}
    result = xr.Dataset({name: found[name] for name in names}, attrs=attributes)
    return result.assign_coords(_coordinates(grid, at.mesh.radius))


def fields_of(data: xr.Dataset) -> list[str]:
    """Return the names of the variables that have a value at each node."""
    names = [str(name) for name in data.data_vars if "node" in data[name].dims]
    return [name for name in names if name not in TOPOLOGY]


def holding(data: xr.Dataset, *names: Hashable) -> list[xr.DataArray]:
    """Return the variables of those names; ConfigError if one is missing."""
    missing = [str(name) for name in names if name not in data]
    if missing:
        raise ConfigError(f"this dataset does not hold {', '.join(missing)}")
    return [data[name] for name in names]


def on_nodes(function: Any, sizes: dict[str, int], *arrays: xr.DataArray, results: int = 1) -> Any:
    """Apply a function of fields (N,) on the nodes at all times; return its results as arrays.

    sizes: the dimensions of each result, which replace the nodes.
    """
    return xr.apply_ufunc(
        function, *arrays, input_core_dims=[["node"]] * len(arrays), vectorize=True,
        output_core_dims=[[*sizes]] * results, dask="parallelized",
        output_dtypes=[np.float64] * results, dask_gufunc_kwargs={"output_sizes": sizes},
    )  # fmt: skip


def _coordinates(grid: Grid, radius: float) -> dict[str, Any]:
    """Return latitudes, longitudes, their bounds [degrees] and areas [m2] of cells, for xarray."""
    about = {"standard_name": "cell_area", "long_name": "area of the cell", "units": "m2"}
    west = -0.5 * float(grid.lon[1])
    lon_edges = np.linspace(west, west + 2.0 * np.pi, grid.lon.size + 1)
    shares = 0.5 * np.diff(np.sin(grid.edges))  # fractions of the sphere's area by row
    zones = 4.0 * np.pi * radius**2 * shares / grid.lon.size
    area = np.repeat(zones[:, None], grid.lon.size, axis=1)
    named: dict[str, Any] = {"cell_area": (("lat", "lon"), area, about)}
    for name, centre, edges in (
        ("lat", grid.lat, grid.edges), ("lon", grid.lon, lon_edges),
    ):  # fmt: skip
        known = VARIABLES["coordinates"][name]
        about = {k: known[k] for k in ("standard_name", "units")} | {"bounds": f"{name}_bnds"}
        bounds = np.degrees(np.stack([edges[:-1], edges[1:]], axis=-1))
        named[name] = (name, np.degrees(centre), about)
        named[f"{name}_bnds"] = ((name, "bnds"), bounds)
    return named
