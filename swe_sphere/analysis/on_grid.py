"""Datasets of runs on grids of latitudes and longitudes, frame by frame when they are computed."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from swe_sphere.analysis.grids import Grid
from swe_sphere.analysis.regrid import CellMeans, Regridder
from swe_sphere.analysis.runs import holding

MESH_ONLY = ("mesh", "location", "coordinates", "grid_mapping", "cell_measures")
"""Attributes of variables that say how they lie on the mesh."""
LEFT_OUT = ("area",)


def on_grid(data: xr.Dataset, bring: Regridder) -> xr.Dataset:
    """All fields on the nodes of a mesh, brought to a grid: (..., lat, lon)."""
    names = [name for name in fields_of(data) if name not in LEFT_OUT]
    found: dict[Any, xr.DataArray] = {}
    if {"u", "v"} & set(names):
        pair = holding(data, "u", "v")
        found |= dict(zip("uv", _applied(bring.wind, bring, *pair), strict=True))
    for name in names:
        if name not in found:
            (found[name],) = _applied(bring.scalar, bring, data[name])
    for name in names:
        found[name].attrs = _attributes(data[name].attrs, isinstance(bring, CellMeans))
    attributes = data.attrs | {"Conventions": "CF-1.11", "grid": bring.grid.name}
    result = xr.Dataset({name: found[name] for name in names}, attrs=attributes)
    return result.assign_coords(_coordinates(bring.grid, bring.mesh.radius))


def fields_of(data: xr.Dataset) -> list[str]:
    """Names of the variables that have a value at each node."""
    return [str(name) for name in data.data_vars if data[name].dims[-1:] == ("node",)]


def on_nodes(function: Any, sizes: dict[str, int], *arrays: xr.DataArray) -> xr.DataArray:
    """A function of fields (N,) at one time, applied at all; it returns an array of those sizes."""
    result: xr.DataArray = xr.apply_ufunc(
        function, *arrays, input_core_dims=[["node"]] * len(arrays),
        output_core_dims=[list(sizes)], vectorize=True, dask="parallelized",
        output_dtypes=[np.float64], dask_gufunc_kwargs={"output_sizes": sizes},
    )  # fmt: skip
    return result


def _applied(function: Any, bring: Regridder, *arrays: xr.DataArray) -> tuple[xr.DataArray, ...]:
    count = len(arrays)
    sizes = dict(zip(("lat", "lon"), bring.grid.shape, strict=True))
    found = xr.apply_ufunc(
        function, *arrays, input_core_dims=[["node"]] * count,
        output_core_dims=[[*sizes]] * count, dask="parallelized",
        output_dtypes=[np.float64] * count, dask_gufunc_kwargs={"output_sizes": sizes},
    )  # fmt: skip
    return found if isinstance(found, tuple) else (found,)


def _attributes(attributes: dict[Any, Any], conservative: bool) -> dict[Any, Any]:
    """Those of a variable on the nodes, for one on a grid."""
    kept = {k: value for k, value in attributes.items() if k not in MESH_ONLY}
    return kept | ({"cell_methods": "area: mean"} if conservative else {})


def _coordinates(grid: Grid, radius: float) -> dict[str, Any]:
    """Latitudes, longitudes, their bounds [degrees] and areas [m2] of cells, for xarray."""
    zones = 4.0 * np.pi * radius**2 * grid.zones / grid.lon.size
    named: dict[str, Any] = {}
    for name, centre, edges, text in (
        ("lat", grid.lat, grid.edges, "north"), ("lon", grid.lon, grid.lon_edges, "east"),
    ):  # fmt: skip
        about = {
            "standard_name": {"lat": "latitude", "lon": "longitude"}[name],
            "units": f"degrees_{text}", "bounds": f"{name}_bnds",
        }  # fmt: skip
        bounds = np.degrees(np.stack([edges[:-1], edges[1:]], axis=-1))
        named[name] = (name, np.degrees(centre), about)
        named[f"{name}_bnds"] = ((name, "bnds"), bounds)
    about = {"standard_name": "cell_area", "long_name": "area of the cell", "units": "m2"}
    area = np.broadcast_to(zones[:, None], grid.shape)
    return named | {"cell_area": (("lat", "lon"), area, about)}
