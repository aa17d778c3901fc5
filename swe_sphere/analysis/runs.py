"""Files of runs as xarray datasets, and what a dataset is of: its mesh, planet and times."""

from __future__ import annotations

import json
import os
from collections.abc import Hashable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.io.layout import MESH_ATTRIBUTES, START
from swe_sphere.io.runfile import RunFile
from swe_sphere.mesh import Mesh
from swe_sphere.planet import Planet

if TYPE_CHECKING:
    import xarray as xr


def mesh_of(data: xr.Dataset) -> Mesh:
    """The mesh on whose nodes the fields are, made again from the attributes.

    Raises ConfigError if the dataset is not of a run.
    """
    missing = [name for name in MESH_ATTRIBUTES if name not in data.attrs]
    if missing or "node" not in data.dims:
        raise ConfigError("this dataset is not of a run: open a file of one (swe_sphere.open_run)")
    values: dict[str, Any] = {name: data.attrs[name] for name in MESH_ATTRIBUTES}
    values |= {name: int(values[name]) for name in ("ne", "np")}
    mesh = Mesh.build(**values)
    if mesh.size != data.sizes["node"]:
        raise ConfigError("this dataset holds a part of the nodes only: the whole run is needed")
    return mesh


def planet_of(data: xr.Dataset) -> Planet:
    """Gravity, rotation and radius of the run."""
    told = data.attrs.get("planet", {})
    values: Mapping[str, float] = json.loads(told) if isinstance(told, str) else told
    return Planet(**values)


def seconds(data: xr.Dataset) -> Array:
    """Times (T,) since the start [s] of the frames; one where there is no such dimension."""
    if "time" not in data.coords:
        return np.zeros(1)
    times = np.atleast_1d(data["time"].values)
    if np.issubdtype(times.dtype, np.datetime64):
        times = (times - np.datetime64(START)) / np.timedelta64(1, "s")
    return times.astype(np.float64)


def holding(data: xr.Dataset, *names: Hashable) -> list[xr.DataArray]:
    """The variables of those names; ConfigError if one is missing."""
    missing = [str(name) for name in names if name not in data]
    if missing:
        raise ConfigError(f"this dataset does not hold {', '.join(missing)}")
    return [data[name] for name in names]


def open_run(path: str | os.PathLike[str], chunks: Mapping[str, int] | None = None) -> xr.Dataset:
    """The file of a run as an xarray dataset: fields on (time, node), series of diagnostics.

    Times are seconds since the start; what the summary of the run says is among the attributes.
    `ds.swe` makes other grids, spectra, streamfunctions, errors and pictures of it: see
    `swe_sphere.analysis.accessor`.

    Args:
        chunks: None: all is read at once.  {"time": 1}: frames are read when they are needed, by
            dask, which must be installed.

    Examples:
        >>> from swe_sphere import Simulation, open_run
        >>> sim = Simulation("williamson2", ne=2, np=4, dt=3600)
        >>> summary = sim.run(days=1, every=6, out="quick.nc")
        >>> run = open_run("quick.nc")
        >>> run.h.dims, run.sizes["time"], run.attrs["completed"]
        (('time', 'node'), 5, True)
        >>> run.swe.to_latlon(19, 36).h.shape
        (5, 19, 36)

    Raises:
        ConfigError: the file is missing, damaged or of another kind.
    """
    import xarray as xr

    from swe_sphere.analysis import accessor  # noqa: F401 - registers `ds.swe`

    found = RunFile(path).attributes
    raw: dict[str, Any] = {"decode_times": False, "mask_and_scale": False}  # whole numbers stay so
    if chunks is not None:
        return xr.open_dataset(path, **raw, chunks=dict(chunks)).assign_attrs(found)
    with xr.open_dataset(path, **raw) as dataset:
        return dataset.load().assign_attrs(found)
