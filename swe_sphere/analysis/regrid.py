"""Fields of runs on grids of latitudes and longitudes: point values or cell means, as datasets."""

from __future__ import annotations

from collections.abc import Hashable, Iterator
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
        """A field (..., N) at the points: (..., M, K)."""
        values = self._sampler(field.reshape(-1, self.mesh.size).T)
        return values.T.reshape(*field.shape[:-1], *self.grid.shape)

    def wind(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Eastward and northward wind at the points, (..., M, K) each, of that at the nodes."""
        pairs = zip(*(x.reshape(-1, self.mesh.size) for x in (u, v)), strict=True)
        found = np.stack([self._sampler.wind(*pair) for pair in pairs], axis=1)
        east, north = found.reshape(2, *u.shape[:-1], *self.grid.shape)
        return east, north


class CellMeans:
    """Means over the cells of a grid, by Gauss quadrature of the polynomials in the elements.

    Of scalars the area mean over the sphere is that over the mesh, to round-off, and constants
    stay what they are: what quadrature leaves is spread evenly over the globe.  All samples of a
    cell are weighed in one matrix, which is kept.
    """

    def __init__(self, mesh: Mesh, grid: Grid) -> None:
        self.mesh, self.grid = mesh, grid
        self._shares = np.repeat(grid.zones / grid.lon.size, grid.lon.size)

    def scalar(self, field: Array) -> Array:
        """Means of a field (..., N): (..., M, K)."""
        rows = field.reshape(-1, self.mesh.size).T
        values: Array = self._scalar @ rows
        values += self.mesh.area @ rows / self.mesh.area.sum() - self._shares @ values
        return values.T.reshape(*field.shape[:-1], *self.grid.shape)

    def wind(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Means of eastward and northward wind, (..., M, K) each, of that at the nodes."""
        both = np.concatenate([x.reshape(-1, self.mesh.size) for x in (u, v)], axis=1).T
        shape = (*u.shape[:-1], *self.grid.shape)
        east, north = ((matrix @ both).T.reshape(shape) for matrix in self._vector)
        return east, north

    @cached_property
    def _scalar(self) -> sparse.csr_array:
        """Quadrature of scalars, (M K, N)."""
        return sparse.vstack([means @ at.matrix for means, at, _ in self._rows()]).tocsr()

    @cached_property
    def _vector(self) -> list[sparse.csr_array]:
        """Quadrature of the eastward and of the northward wind, (M K, 2 N) each."""
        parts = [_turned(means, at, units) for means, at, units in self._rows()]
        return [sparse.vstack(column).tocsr() for column in zip(*parts, strict=True)]

    def _rows(self) -> Iterator[tuple[sparse.csr_array, Interpolator, Array]]:
        """Row after row of cells: their means of samples, the samples, and the frames there."""
        count, width = self.grid.lon.size, 2.0 * np.pi / self.grid.lon.size
        spacing = self.mesh.spacing()[0] / self.mesh.radius
        samples = FEWEST + int(max(width, np.diff(self.grid.edges).max()) / spacing)
        nodes, weights = np.polynomial.legendre.leggauss(samples)
        lon = (self.grid.lon[:, None] + 0.5 * width * nodes)[:, None, :]
        share = np.outer(weights, weights).ravel() / 4.0
        means = sparse.kron(sparse.eye_array(count), share[None, :]).tocsr()
        for low, high in pairwise(np.sin(self.grid.edges)):
            lat = np.arcsin(0.5 * (low + high) + 0.5 * (high - low) * nodes)[None, :, None]
            points = [x.ravel() for x in np.broadcast_arrays(lon, lat)]
            yield means, Interpolator(self.mesh, *points), np.stack(frame(*points))


def _turned(
    means: sparse.csr_array, at: Interpolator, units: Array
) -> tuple[sparse.csr_array, sparse.csr_array]:
    """Means of the components along east and north of a wind (2 N) in the frames of the nodes."""
    matrix, units_at_nodes = at.matrix, np.concatenate([at.mesh.east.T, at.mesh.north.T])
    own = [sparse.diags_array(x) for x in units_at_nodes]

    def along(unit: Array) -> sparse.csr_array:
        parts = [means @ sparse.diags_array(x) @ matrix for x in unit.T]
        blocks = [sum(p @ o for p, o in zip(parts, own[k : k + 3], strict=True)) for k in (0, 3)]
        return sparse.hstack(blocks).tocsr()

    return along(units[0]), along(units[1])


Regridder = Points | CellMeans
"""Brings fields from the nodes of a mesh to a grid."""


def regridder(mesh: Mesh, grid: Grid, conservative: bool = False) -> Regridder:
    """The one for values at points, or for means that conserve."""
    return CellMeans(mesh, grid) if conservative else Points(mesh, grid)


MESH_ONLY = ("mesh", "location", "coordinates", "grid_mapping", "cell_measures")
"""Attributes of variables that say how they lie on the mesh."""


def on_grid(data: xr.Dataset, bring: Regridder) -> xr.Dataset:
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
