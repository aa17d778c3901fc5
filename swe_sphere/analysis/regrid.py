"""Fields of runs on grids of latitudes and longitudes: point values or cell means, as datasets."""

from __future__ import annotations

from collections.abc import Hashable
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr
from scipy import sparse

from swe_sphere.analysis.grids import Grid
from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.io.layout import TOPOLOGY, VARIABLES
from swe_sphere.mesh import Interpolator, Mesh
from swe_sphere.mesh.sphere import frame

FEWEST = 3
"""Gauss points of a cell in either direction, and one more for every node that it spans."""


class Points:
    """Values at the points of a grid, of the polynomials that a field is in each element."""

    def __init__(self, mesh: Mesh, grid: Grid) -> None:
        self.mesh, self.grid = mesh, grid
        lon, lat = grid.points
        self._sampler = Interpolator(mesh, lon.ravel(), lat.ravel())

    def scalar(self, field: Array) -> Array:
        """A field (..., N) on the grid: (..., M, K)."""
        return self._on_grid(self._sampler(self._columns(field)), field)

    def wind(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Eastward and northward wind on the grid, (..., M, K) each, of that at the nodes."""
        columns = zip(self._columns(u).T, self._columns(v).T, strict=True)
        found = zip(*(self._sampler.wind(*pair) for pair in columns), strict=True)
        east, north = (self._on_grid(np.stack(x, axis=1), u) for x in found)
        return east, north

    def _columns(self, field: Array) -> Array:
        """Return a field (..., N) as the columns of a matrix (N, ...)."""
        return field.reshape(-1, self.mesh.size).T

    def _on_grid(self, values: Array, field: Array) -> Array:
        """Return values (M K, ...) in the shape (..., M, K) that the field has on the grid."""
        return values.T.reshape(*field.shape[:-1], *self.grid.shape)


class CellMeans(Points):
    """Means over the cells of a grid, by Gauss quadrature of the polynomials in the elements.

    Of scalars the area mean over the sphere is that over the mesh, to round-off, and constants
    stay what they are: what quadrature leaves is spread evenly over the globe.  All samples of a
    cell are weighed in one matrix, which is kept.
    """

    def __init__(self, mesh: Mesh, grid: Grid) -> None:
        self.mesh, self.grid = mesh, grid

    def scalar(self, field: Array) -> Array:
        columns, shares = self._columns(field), np.repeat(self.grid.zones, self.grid.lon.size)
        values: Array = self._matrices[0] @ columns
        values += np.average(columns, 0, self.mesh.area) - np.average(values, 0, shares)
        return self._on_grid(values, field)

    def wind(self, u: Array, v: Array) -> tuple[Array, Array]:
        axes = zip(self.mesh.east.T, self.mesh.north.T, strict=True)
        columns = self._columns(u).T, self._columns(v).T
        xyz = np.hstack([columns[0] * east + columns[1] * north for east, north in axes]).T
        along, up = (self._on_grid(matrix @ xyz, u) for matrix in self._matrices[1:])
        return along, up

    @cached_property
    def _matrices(self) -> list[sparse.csr_array]:
        """Quadrature (M K, N) of scalars; (M K, 3 N) of winds (x, y, z) along east and north."""
        count, width = self.grid.lon.size, 2.0 * np.pi / self.grid.lon.size
        spacing = self.mesh.spacing()[0] / self.mesh.radius
        samples = FEWEST + int(max(width, np.diff(self.grid.edges).max()) / spacing)
        nodes, weights = np.polynomial.legendre.leggauss(samples)
        lon = (self.grid.lon[:, None] + 0.5 * width * nodes)[:, None, :]
        share = np.outer(weights, weights).reshape(1, -1) / 4.0
        means, rows = sparse.kron(sparse.eye_array(count), share).tocsr(), []
        for low, high in pairwise(np.sin(self.grid.edges)):  # a row of cells after the other
            lat = np.arcsin(0.5 * (low + high) + 0.5 * (high - low) * nodes)[None, :, None]
            points = [x.ravel() for x in np.broadcast_arrays(lon, lat)]
            at = Interpolator(self.mesh, *points).matrix
            rows.append([means @ at])
            for unit in frame(*points):
                along = [means @ sparse.diags_array(x) @ at for x in unit.T]
                rows[-1].append(sparse.hstack(along))
        return [sparse.vstack(column).tocsr() for column in zip(*rows, strict=True)]


MESH_ONLY = ("mesh", "location", "coordinates", "grid_mapping", "cell_measures")
"""Attributes of variables that say how they lie on the mesh."""


def on_grid(data: xr.Dataset, bring: Points) -> xr.Dataset:
    """Return all fields on the nodes of a mesh, brought to a grid: (..., lat, lon)."""
    names = [name for name in fields_of(data) if name != "area"]
    sizes = dict(zip(("lat", "lon"), bring.grid.shape, strict=True))
    found: dict[str, xr.DataArray] = {}
    if {"u", "v"} & set(names):
        pair = holding(data, "u", "v")
        found["u"], found["v"] = on_nodes(bring.wind, sizes, *pair, results=2, at_once=True)
    means = {"cell_methods": "area: mean"} if isinstance(bring, CellMeans) else {}
    for name in names:
        if name not in found:
            found[name] = on_nodes(bring.scalar, sizes, data[name], at_once=True)
        kept = {k: value for k, value in data[name].attrs.items() if k not in MESH_ONLY}
        found[name].attrs = kept | means
    attributes = data.attrs | {"Conventions": "CF-1.11", "grid": bring.grid.name}
    result = xr.Dataset({name: found[name] for name in names}, attrs=attributes)
    return result.assign_coords(_coordinates(bring.grid, bring.mesh.radius))


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


def on_nodes(
    function: Any,
    sizes: dict[str, int],
    *arrays: xr.DataArray,
    results: int = 1,
    at_once: bool = False,
) -> Any:
    """Apply a function of fields on the nodes at all times; return its results as arrays.

    sizes: the dimensions of each result, in the place of the nodes.  at_once: whether the function
    takes fields (..., N) of several times, and not only (N,) of one.
    """
    return xr.apply_ufunc(
        function, *arrays, input_core_dims=[["node"]] * len(arrays),
        output_core_dims=[[*sizes]] * results, vectorize=not at_once, dask="parallelized",
        output_dtypes=[np.float64] * results, dask_gufunc_kwargs={"output_sizes": sizes},
    )  # fmt: skip


def _coordinates(grid: Grid, radius: float) -> dict[str, Any]:
    """Return latitudes, longitudes, their bounds [degrees] and areas [m2] of cells, for xarray."""
    about = {"standard_name": "cell_area", "long_name": "area of the cell", "units": "m2"}
    zones = 4.0 * np.pi * radius**2 * grid.zones / grid.lon.size
    area = np.broadcast_to(zones[:, None], grid.shape)
    named: dict[str, Any] = {"cell_area": (("lat", "lon"), area, about)}
    for name, centre, edges in (
        ("lat", grid.lat, grid.edges), ("lon", grid.lon, grid.lon_edges),
    ):  # fmt: skip
        known = VARIABLES["coordinates"][name]
        about = {k: known[k] for k in ("standard_name", "units")} | {"bounds": f"{name}_bnds"}
        bounds = np.degrees(np.stack([edges[:-1], edges[1:]], axis=-1))
        named[name] = (name, np.degrees(centre), about)
        named[f"{name}_bnds"] = ((name, "bnds"), bounds)
    return named
