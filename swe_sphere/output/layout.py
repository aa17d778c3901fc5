"""What stands in an output file before the first frame: dimensions, mesh, variables, attributes.

CF-1.11 (cfconventions.org) and UGRID-1.0 (ugrid-conventions.github.io): the GLL points are the
nodes of the mesh, the (np-1)^2 sub-quads of each element its faces, data live on the nodes.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import netCDF4
import numpy as np
from numpy.typing import ArrayLike

from swe_sphere.mesh import Mesh

__all__ = [
    "FRAME_FIELDS", "LAYOUT_BYTES", "MESH_ATTRIBUTES", "SERIES_CHUNK", "TRACER",
    "add_diagnostic", "add_layout", "attribute", "frame_fields",
]  # fmt: skip

FRAME_FIELDS = {
    "h": {"long_name": "depth of the fluid", "units": "m"},
    "u": {"standard_name": "eastward_wind", "long_name": "eastward wind", "units": "m s-1"},
    "v": {"standard_name": "northward_wind", "long_name": "northward wind", "units": "m s-1"},
    "vorticity": {
        "standard_name": "atmosphere_upward_relative_vorticity",
        "long_name": "relative vorticity",
        "units": "s-1",
    },
    "divergence": {
        "standard_name": "divergence_of_wind",
        "long_name": "divergence of the wind",
        "units": "s-1",
    },
}
"""Fields of every frame and their attributes."""

TRACER = "q_"
"""What the names of variables that hold the mixing ratio of a tracer begin with."""

STATIC_FIELDS = {
    "b": {"standard_name": "surface_altitude", "long_name": "height of the bottom", "units": "m"},
    "area": {
        "standard_name": "cell_area",
        "long_name": "quadrature weight of the node, its share of the sphere's area",
        "units": "m2",
    },
}
COORDINATES = {
    "lat": {"standard_name": "latitude", "long_name": "latitude", "units": "degrees_north"},
    "lon": {"standard_name": "longitude", "long_name": "longitude", "units": "degrees_east"},
}
ON_NODES = {"mesh": "mesh", "location": "node", "coordinates": "lat lon", "grid_mapping": "sphere"}
TIME = {"units": "seconds since 2000-01-01 00:00:00", "calendar": "proleptic_gregorian"}

DIAGNOSTICS = {
    "mass": ("area mean of the fluid depth", "m"),
    "energy": ("area mean of the total energy per unit density", "m3 s-2"),
    "potential_enstrophy": ("area mean of the potential enstrophy", "m-1 s-2"),
    "total_vorticity": ("area mean of the relative vorticity", "s-1"),
    "total_divergence": ("area mean of the divergence", "s-1"),
    "max_wind": ("largest wind speed", "m s-1"),
    "min_depth": ("least fluid depth", "m"),
    "max_wave": ("largest gravity wave speed", "m s-1"),
    "max_signal": ("largest wind speed plus gravity wave speed", "m s-1"),
}
"""Long names and units of the series of diagnostics; others are plain numbers."""

MESH_ATTRIBUTES = ("ne", "np", "radius", "stretch", "centre", "spin")
"""Global attributes [m, rad] from which `build_mesh` makes the mesh of the file again."""

SERIES_CHUNK = 512
"""Numbers of a series that take their room in the file together."""

LAYOUT_BYTES = 56
"""Bytes per node that `add_layout` writes: lat, lon, area, b and the corners of one face."""


def frame_fields(tracers: Iterable[str] = ()) -> dict[str, dict[str, str]]:
    """Fields of every frame of a run with those tracers, and their attributes."""
    ratios = {
        f"{TRACER}{name}": {"long_name": f"mixing ratio of tracer {name}", "units": "1"}
        for name in tracers
    }
    return FRAME_FIELDS | ratios


def add_layout(
    dataset: netCDF4.Dataset,
    mesh: Mesh,
    bottom: ArrayLike | None,
    fields: Mapping[str, Mapping[str, str]],
) -> None:
    """Define everything but diagnostics and checkpoints, and write what does not change.

    fields: those of every frame with their attributes.
    """
    for name, size in {"time": None, "diagnostic_time": None, "node": mesh.size}.items():
        dataset.createDimension(name, size)
    dataset.setncatts({
        "Conventions": "CF-1.11 UGRID-1.0",
        "source": "swe_sphere: spectral elements on the cubed sphere",
    })  # fmt: skip
    dataset.setncatts({name: attribute(getattr(mesh, name)) for name in MESH_ATTRIBUTES})
    _add_topology(dataset, mesh)
    _add_times(dataset)
    _add_nodal(dataset, mesh, np.zeros(mesh.size) if bottom is None else bottom)
    _add_frames(dataset, mesh, fields)


def _add_topology(dataset: netCDF4.Dataset, mesh: Mesh) -> None:
    quads = mesh.quads()
    dataset.createDimension("face", len(quads))
    dataset.createDimension("corner", 4)
    dataset.createVariable("mesh", "i4").setncatts({
        "cf_role": "mesh_topology",
        "long_name": "Gauss-Lobatto-Legendre points of the elements and the quads between them",
        "topology_dimension": 2,
        "node_coordinates": "lon lat",
        "face_node_connectivity": "face_nodes",
        "face_dimension": "face",
    })  # fmt: skip
    faces = dataset.createVariable("face_nodes", "i4", ("face", "corner"))
    faces.setncatts({
        "cf_role": "face_node_connectivity",
        "long_name": "corner nodes of each quad, anticlockwise",
        "start_index": np.int32(0),
    })  # fmt: skip
    faces[:] = quads
    sphere = {"grid_mapping_name": "latitude_longitude", "earth_radius": mesh.radius}
    dataset.createVariable("sphere", "i4").setncatts(sphere)


def _add_times(dataset: netCDF4.Dataset) -> None:
    for name, text in {"time": "time", "diagnostic_time": "time of the diagnostics"}.items():
        variable = dataset.createVariable(name, "f8", (name,), chunksizes=(SERIES_CHUNK,))
        variable.setncatts({"standard_name": "time", "long_name": text, **TIME})
    dataset["time"].axis = "T"


def _add_nodal(dataset: netCDF4.Dataset, mesh: Mesh, bottom: ArrayLike) -> None:
    values = {"lat": np.degrees(mesh.lat), "lon": np.degrees(mesh.lon), "area": mesh.area}
    for name, attributes in (COORDINATES | STATIC_FIELDS).items():
        variable = dataset.createVariable(name, "f8", ("node",))
        variable.setncatts(attributes | ({} if name in COORDINATES else ON_NODES))
        variable[:] = bottom if name == "b" else values[name]


def _add_frames(
    dataset: netCDF4.Dataset, mesh: Mesh, fields: Mapping[str, Mapping[str, str]]
) -> None:
    for name, attributes in fields.items():
        variable = dataset.createVariable(
            name, "f8", ("time", "node"), chunksizes=(1, mesh.size), fill_value=np.nan
        )
        variable.setncatts({**attributes, **ON_NODES, "cell_measures": "area: area"})


def add_diagnostic(dataset: netCDF4.Dataset, name: str) -> netCDF4.Variable[np.float64]:
    """A new series of numbers along `diagnostic_time`, missing so far.

    Raises ValueError if the name is one of the file's own.
    """
    if name in dataset.variables:
        raise ValueError(f"a diagnostic cannot be called {name!r}: the file has that variable")
    variable = dataset.createVariable(
        name, "f8", ("diagnostic_time",), chunksizes=(SERIES_CHUNK,), fill_value=np.nan
    )
    text, units = DIAGNOSTICS.get(name, (name.replace("_", " "), "1"))
    variable.setncatts({"long_name": text, "units": units})
    return variable


def attribute(value: object) -> Any:
    """A value as netCDF can hold it: numbers, texts and rows of numbers; the rest as JSON."""
    if isinstance(value, (str, float, int, np.number)) and not isinstance(value, bool):
        return value
    if isinstance(value, Sequence) and value and all(type(x) in (int, float) for x in value):
        return np.asarray(value)
    if isinstance(value, Mapping):
        value = dict(value)
    return json.dumps(value, default=str)
