"""Fields of runs on global grids of latitudes and longitudes.

`latlon:181x360` has 181 latitudes (rows) and 360 longitudes (columns), both evenly spaced. With an
odd number of rows the first and the last lie on the poles, and their cells have half the height;
with an even number all rows lie in the middle of equal cells. `gaussian:N` has 2N Gauss latitudes
and 4N longitudes. Longitudes begin at 0 and go east, latitudes go from south to north.
"""

import re
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy
import xarray as xr

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError, shown, unknown_name
from swe_sphere.files.durable import building, translate_errors
from swe_sphere.io.growing import check_free, check_zarr
from swe_sphere.io.layout import SERIES, TOPOLOGY, VARIABLES, history
from swe_sphere.io.runfile import RunFile, engine, read_values
from swe_sphere.mesh import Interpolator
from swe_sphere.settings.values import convert

MOST_POINTS = 2**28
"""Largest number of points of a grid: a field of this size occupies 2 GiB."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Points at all pairs of latitudes (M,) and longitudes (K,) [rad], and the cells around them.

    edges (M+1,) [rad]: latitudes of the southern and northern edges of the cells. The areas of the
    cells are the weights of integrals over the sphere.
    """

    name: str
    lat: Array
    lon: Array
    edges: Array

    @property
    def points(self) -> tuple[Array, Array]:
        """Longitude and latitude (M, K) [rad] of all points."""
        return np.meshgrid(self.lon, self.lat)


def parse_grid(text: str) -> Grid:
    """Return the grid latlon:ROWSxCOLUMNS or gaussian:N; ConfigError for other texts or sizes."""
    if found := re.fullmatch(r"latlon:(\d{1,9})x(\d{1,9})", text):
        return lat_lon(*map(int, found.groups()))
    if found := re.fullmatch(r"gaussian:(\d{1,9})", text):
        return gaussian(int(found[1]))
    raise ConfigError(
        f"there is no grid {shown(text)}: use latlon:ROWSxCOLUMNS (latlon:181x360) or gaussian:N"
        " (2N latitudes, 4N longitudes)"
    )


def lat_lon(rows: int, columns: int) -> Grid:
    """Return the evenly spaced grid; ConfigError for fewer than 2 latitudes or 4 longitudes."""
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
    """Return the grid of 2n Gauss latitudes and 4n longitudes; ConfigError for n < 1.

    The heights of cells follow from the Gauss weights, so that sums over them are Gauss quadrature.
    """
    n = convert("n", int, n)
    lon = _around(name := f"gaussian:{n}", 2 * n, 4 * n)
    sines, weights = scipy.special.roots_legendre(2 * n)
    edges = np.arcsin(np.clip(np.concatenate([[-1.0], np.cumsum(weights) - 1.0]), -1.0, 1.0))
    edges[-1] = 0.5 * np.pi
    return Grid(name, np.arcsin(sines), lon, edges)


def _around(name: str, rows: int, columns: int) -> Array:
    """Return the longitudes [rad] of a grid; ConfigError if the grid is too small or too large."""
    if rows < 2 or columns < 4:
        raise ConfigError(f"the grid {name} is too small: at least 2 latitudes and 4 longitudes")
    if rows * columns > MOST_POINTS:
        raise ConfigError(f"the grid {name} is too large: at most {MOST_POINTS} points")
    return np.arange(columns, dtype=float) * (2.0 * np.pi / columns)


def on_grid(data: xr.Dataset, at: Interpolator, grid: Grid) -> xr.Dataset:
    """Interpolate all `fields_of` a dataset to the points of a grid: (..., lat, lon)."""
    on_mesh = ("mesh", "location", "coordinates", "grid_mapping", "cell_measures")
    names = [name for name in fields_of(data) if name != "area"]
    sizes = {"lat": grid.lat.size, "lon": grid.lon.size}
    found: dict[str, xr.DataArray] = {}
    if {"u", "v"} & {*data.data_vars}:
        holding(data, "u", "v")
        found["u"], found["v"] = on_nodes(at.wind, sizes, data["u"], data["v"], results=2)
    for name in names:
        if name not in found:
            found[name] = on_nodes(at, sizes, data[name])
        found[name].attrs = {k: x for k, x in data[name].attrs.items() if k not in on_mesh}
    attributes = data.attrs | {"Conventions": "CF-1.11", "grid": grid.name}
    result = xr.Dataset({name: found[name] for name in names}, attrs=attributes)
    return result.assign(data[profiles_of(data)]).assign_coords(_coordinates(grid, at.mesh.radius))


def fields_of(data: xr.Dataset) -> list[str]:
    """Return the names of the variables on the nodes, without a component of the wind alone."""
    names = [str(name) for name in data.data_vars if "node" in data[name].dims]
    skipped = TOPOLOGY if {"u", "v"} <= {*names} else [*TOPOLOGY, "u", "v"]
    return [name for name in names if name not in skipped]


def profiles_of(data: xr.Dataset) -> list[Hashable]:
    """Return the names of the variables that have values at each time, but not at nodes."""
    return [n for n, x in data.data_vars.items() if "time" in x.dims and "node" not in x.dims]


def holding(data: xr.Dataset, *names: Hashable) -> list[xr.DataArray]:
    """Return the variables of those names; ConfigError if one is missing."""
    if missing := [str(name) for name in names if name not in data]:
        raise ConfigError(f"this dataset does not hold {', '.join(missing)}")
    return [data[name] for name in names]


def on_nodes(function: Any, sizes: dict[str, int], *arrays: xr.DataArray, results: int = 1) -> Any:
    """Apply a function of nodal fields (N,) at all times; return its `results` as data arrays.

    sizes: the dimensions of each result, which replace the dimension "node".
    """
    whole = [array.chunk(node=-1) if array.chunks else array for array in arrays]
    return xr.apply_ufunc(
        function, *whole, input_core_dims=[["node"]] * len(arrays), vectorize=True,
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
    for name, centre, edges in (("lat", grid.lat, grid.edges), ("lon", grid.lon, lon_edges)):
        known = VARIABLES["coordinates"][name]
        about = {k: known[k] for k in ("standard_name", "units")} | {"bounds": f"{name}_bnds"}
        bounds = np.degrees(np.stack([edges[:-1], edges[1:]], axis=-1))
        named[name] = (name, np.degrees(centre), about)
        named[f"{name}_bnds"] = ((name, "bnds"), bounds)
    return named


def regrid_file(
    path: Path, grid: str, out: Path, fields: Sequence[str] = (), overwrite: bool = False
) -> Path:
    """Interpolate the frames of a run to a grid, one at a time, into compressed netCDF-4 or Zarr.

    path: file of the run. grid: latlon:ROWSxCOLUMNS or gaussian:N. out: a name ending in .nc, or in
    .zarr, which needs the package zarr; the file gets its name when it is complete. fields: the
    requested variables, all if empty; u and v go together. overwrite: replace an existing `out`.

    Memory contains one frame on the mesh and on the grid, and an interpolation matrix below 200 MB.

    Returns out. Raises ConfigError if the file is not that of a run or lacks a field, if there is
    no such grid, or if `out` exists already or cannot be written.
    """
    found = RunFile(path)
    if found.times.size == 0:
        raise ConfigError(f"{path} holds no frame yet")
    wanted = parse_grid(grid)
    at = Interpolator(found.mesh, *wanted.points)
    writers = {".nc": _write_netcdf, ".zarr": _write_zarr}
    if (ending := out.suffix.lower()) not in writers:
        raise ConfigError(f"cannot write {out}: give a name ending in .nc or .zarr")
    if not out.parent.is_dir():
        raise ConfigError(f"cannot write {out}: there is no folder {out.parent}")
    check_free(out, overwrite)
    if ending == ".zarr":
        check_zarr(out)
    with (
        xr.open_dataset(path, engine=engine(path), decode_times=False) as data,
        translate_errors(f"cannot write {out}"),
    ):
        if out.exists() and out.samefile(path):
            raise ConfigError(f"{out} is the input file: choose another name")
        chosen = _chosen(data, fields)
        before = str(data.attrs.get("history", ""))
        chosen.attrs["history"] = history(f"regrid {path.name} --grid {grid}", before)
        with building(out) as part:
            writers[ending](part, _frames(path, chosen, at, wanted))
    return out


def _chosen(data: xr.Dataset, fields: Sequence[str]) -> xr.Dataset:
    """Return the requested fields on the nodes and the series; without `fields` also profiles."""
    there = fields_of(data)
    # the directions east and north vary in space: the wind is interpolated as a vector
    whole = ["u", "v"] if {"u", "v"} & {*(fields or data.data_vars)} else []
    if not {*whole} <= {*there}:
        raise ConfigError("u and v are interpolated together, but the run does not hold both")
    for name in sorted({*fields}.difference(there)):
        raise unknown_name("field", name, there)
    others = [name for name in data.data_vars if data[name].dims == (SERIES,)]
    others += [] if fields else profiles_of(data)
    return data[[*dict.fromkeys([*(fields or there), *whole]), *others]]


def _frames(path: Path, data: xr.Dataset, at: Interpolator, grid: Grid) -> Iterator[xr.Dataset]:
    """Yield the frames of a file on the grid; the first also has constant fields and the series."""
    series = data[[name for name in data.data_vars if data[name].dims == (SERIES,)]]
    data = data.drop_dims(SERIES, errors="ignore")
    changing = data[[name for name in data.data_vars if "time" in data[name].dims]]
    for k in range(data.sizes.get("time", 1)):
        frame = (changing if k else data).isel(time=[k], missing_dims="ignore").load()
        for name in frame.data_vars:
            read_values(path, str(name), frame[name].variable)
        found = on_grid(frame, at, grid)
        yield found if k else found.merge(series)


def _write_netcdf(path: Path, frames: Iterator[xr.Dataset]) -> None:
    import netCDF4  # slow to import

    first = next(frames)
    compression = {"zlib": True, "complevel": 4, "shuffle": True}
    packed = {name: compression for name in first.data_vars if first[name].ndim > 1}
    first.to_netcdf(path, "w", "NETCDF4", encoding=packed, unlimited_dims={"time"} & {*first.dims})
    with netCDF4.Dataset(path, "a") as file:
        for k, frame in enumerate(frames, start=1):
            for name in ("time", *frame.data_vars):
                file[str(name)][k] = frame[name].values[0]


def _write_zarr(path: Path, frames: Iterator[xr.Dataset]) -> None:
    next(frames).to_zarr(path, mode="w", zarr_format=2, consolidated=True)
    for frame in frames:
        changing = frame.drop_vars([n for n in frame.variables if "time" not in frame[n].dims])
        changing.to_zarr(path, append_dim="time", consolidated=True)
