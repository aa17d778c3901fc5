"""Files of runs on grids of latitudes and longitudes, frame by frame."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import netCDF4
import xarray as xr

from swe_sphere.analysis.regrid import Grid, fields_of, on_grid, parse_grid
from swe_sphere.errors import ConfigError, unknown_name
from swe_sphere.files.durable import building, check_free, clear_errors
from swe_sphere.io.growing import check_zarr
from swe_sphere.io.layout import SERIES, history
from swe_sphere.io.runfile import RunFile, checked, engine
from swe_sphere.mesh import Interpolator


def regrid_file(
    path: Path, grid: str, out: Path, fields: Sequence[str] = (), overwrite: bool = False
) -> Path:
    """Interpolate the frames of a run to a grid, one at a time: netCDF-4, compressed, or Zarr.

    grid: latlon:ROWSxCOLUMNS or gaussian:N. out: ends in .nc, or in .zarr, which needs the package
    zarr; the file gets its name when it is complete. fields: the requested variables, all if empty;
    the wind is always included as a vector.

    Memory holds one frame on the mesh and on the grid, and the interpolation matrix if it is
    smaller than 200 MB.

    Returns out. Raises ConfigError if the file is not of a run or lacks a field, if there is no
    such grid, or if `out` exists already or cannot be written.
    """
    found = RunFile(path)
    if found.times.size == 0:
        raise ConfigError(f"{path} holds no frame yet")
    wanted = parse_grid(grid)
    at = Interpolator(found.mesh, *wanted.points)
    if out.suffix not in (".nc", ".zarr"):
        raise ConfigError(f"cannot write {out}: give a name ending in .nc or .zarr")
    if not out.parent.is_dir():
        raise ConfigError(f"cannot write {out}: there is no folder {out.parent}")
    check_free(out, overwrite)
    is_zarr = out.suffix == ".zarr"
    if is_zarr:
        check_zarr(out)
    with (
        xr.open_dataset(path, engine=engine(path), decode_times=False) as data,
        clear_errors(f"cannot write {out}"),
    ):
        if out.exists() and out.samefile(path):
            raise ConfigError(f"{out} is the input file: choose another name")
        chosen = _chosen(data, fields)
        before = str(data.attrs.get("history", ""))
        chosen.attrs["history"] = history(f"regrid {path.name} --grid {grid}", before)
        with building(out, is_zarr) as part:
            (_write_zarr if is_zarr else _write_netcdf)(part, _frames(path, chosen, at, wanted))
    return out


def _chosen(data: xr.Dataset, fields: Sequence[str]) -> xr.Dataset:
    """Return the requested fields on the nodes, with the series of diagnostics."""
    there = fields_of(data)
    for name in sorted({*fields}.difference(there)):
        raise unknown_name("field", name, there)
    series = [name for name in data.data_vars if data[name].dims == (SERIES,)]
    # east and north differ from point to point: the wind is interpolated as a vector
    whole = ["u", "v"] if {"u", "v"} & set(fields) else []
    return data[[*dict.fromkeys([*(fields or there), *whole]), *series]]


def _frames(path: Path, data: xr.Dataset, at: Interpolator, grid: Grid) -> Iterator[xr.Dataset]:
    """Yield frame after frame of a file on the grid; the series come with the first."""
    series = data[[name for name in data.data_vars if data[name].dims == (SERIES,)]]
    data = data.drop_dims(SERIES, errors="ignore")
    changing = data[[name for name in data.data_vars if "time" in data[name].dims]]
    for k in range(data.sizes["time"]):
        frame = (changing if k else data).isel(time=[k]).load()
        for name in frame.data_vars:
            checked(path, str(name), frame[name].variable)
        found = on_grid(frame, at, grid)
        yield found if k else found.merge(series)


def _write_netcdf(path: Path, frames: Iterator[xr.Dataset]) -> None:
    first = next(frames)
    compression = {"zlib": True, "complevel": 4, "shuffle": True}
    encoding = {name: compression for name in first.data_vars if first[name].ndim > 1}
    first.to_netcdf(path, "w", format="NETCDF4", encoding=encoding, unlimited_dims=["time"])
    with netCDF4.Dataset(path, "a") as file:
        for k, frame in enumerate(frames, start=1):
            for name in ("time", *frame.data_vars):
                file[str(name)][k] = frame[name].values[0]


def _write_zarr(path: Path, frames: Iterator[xr.Dataset]) -> None:
    next(frames).to_zarr(path, mode="w", zarr_format=2, consolidated=True)
    for frame in frames:
        changing = frame.drop_vars([n for n in frame.variables if "time" not in frame[n].dims])
        changing.to_zarr(path, append_dim="time", consolidated=True)
