"""What a dataset of a run is of: its mesh, planet and times."""

from __future__ import annotations

import json
from collections.abc import Hashable, Mapping
from typing import Any

import numpy as np
import xarray as xr

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.io.layout import MESH_ATTRIBUTES, START
from swe_sphere.mesh import Mesh
from swe_sphere.planet import Planet


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
    """Times (T,) since the start [s] of the frames; one where there is no such dimension.

    Raises ConfigError if there is no frame.
    """
    if "time" not in data.coords:
        return np.zeros(1)
    times = np.atleast_1d(data["time"].values)
    if times.size == 0:
        raise ConfigError("this dataset holds no frame")
    if np.issubdtype(times.dtype, np.datetime64):
        times = (times - np.datetime64(START)) / np.timedelta64(1, "s")
    return times.astype(np.float64)


def holding(data: xr.Dataset, *names: Hashable) -> list[xr.DataArray]:
    """The variables of those names; ConfigError if one is missing."""
    missing = [str(name) for name in names if name not in data]
    if missing:
        raise ConfigError(f"this dataset does not hold {', '.join(missing)}")
    return [data[name] for name in names]
