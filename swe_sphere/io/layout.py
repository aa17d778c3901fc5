"""What stands in an output file before the first frame: dimensions, mesh, variables, attributes.

All is defined before anything is written, and what is large last: every definition makes the netCDF
library move all variables of fixed size that stand in the file already.

CF-1.11 (cfconventions.org) and UGRID-1.0 (ugrid-conventions.github.io): the GLL points are the
nodes of the mesh, the (np-1)^2 sub-quads of each element its faces, data live on the nodes.  For
tools that know values of cells alone, the bounds of the coordinates are those of a cell a node.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import netCDF4
import numpy as np
from numpy.typing import ArrayLike, NDArray

from swe_sphere import __version__
from swe_sphere.mesh import Mesh
from swe_sphere.mesh.cells import cell_corners

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
    "f": {
        "standard_name": "coriolis_parameter",
        "long_name": "Coriolis parameter",
        "units": "s-1",
    },
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
BOUNDS = "_bnds"
"""What the names of the bounds of a coordinate end with."""
TOPOLOGY = ("mesh", "face_nodes", "sphere", *(name + BOUNDS for name in COORDINATES))
ON_NODES = {"mesh": "mesh", "location": "node", "coordinates": "lat lon", "grid_mapping": "sphere"}
MEASURES = {"cell_measures": "area: area"}
START = "2000-01-01"
"""The date that files give the start of a run."""
TIME = {
    "standard_name": "time",
    "units": f"seconds since {START} 00:00:00",
    "calendar": "proleptic_gregorian",
    "units_metadata": "leap_seconds: none",
}

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
"""Global attributes [m, degrees] from which `Mesh.build` makes the mesh of the file again."""

SERIES = "diagnostic_time"
"""The dimension of the series of diagnostics, and the variable with its times."""

SUMMARY = "summary"
"""The global attribute that tells how the run ended, in JSON."""
SUMMARY_BYTES = 32 * 1024
"""Room for it."""

LAYOUT_BYTES = 128
"""Bytes per node that `add_layout` writes: lat, lon, four corners of each, area, b, f, one face."""


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
    constants: Mapping[str, ArrayLike],
    fields: Mapping[str, Mapping[str, str]],
    diagnostics: Mapping[str, Mapping[str, str]],
    samples: int,
) -> None:
    """Define everything, and write what does not change.

    constants: height of the bottom "b" [m] and Coriolis parameter "f" [s-1] at the nodes, zero
    where absent.  fields: those of every frame with their attributes.  diagnostics: the series,
    with attributes where they are the user's own, each with room for so many samples; none: there
    is no dimension for them either.

    Raises ValueError if a series is called like something else in the file.
    """
    quads = mesh.quads()
    dataset.setncatts({
        "Conventions": "CF-1.11 UGRID-1.0",
        "source": f"swe_sphere {__version__}: spectral elements on the cubed sphere",
        SUMMARY: " " * SUMMARY_BYTES,
    })  # fmt: skip
    dataset.setncatts({name: attribute(getattr(mesh, name)) for name in MESH_ATTRIBUTES})
    sizes = {"time": None, "node": mesh.size, "face": len(quads), "corner": 4}
    for name, size in sizes.items():
        dataset.createDimension(name, size)
    _add_frames(dataset, fields)
    _add_series(dataset, diagnostics, samples)
    _add_topology(dataset, mesh)
    for name, attributes in (COORDINATES | STATIC_FIELDS).items():
        nodal = {"bounds": name + BOUNDS} if name in COORDINATES else ON_NODES
        dataset.createVariable(name, "f8", ("node",)).setncatts(attributes | nodal)
    for name in COORDINATES:
        dataset.createVariable(name + BOUNDS, "f8", ("node", "corner"))
    _fill(dataset, mesh, quads, constants)


def _add_topology(dataset: netCDF4.Dataset, mesh: Mesh) -> None:
    dataset.createVariable("mesh", "i4").setncatts({
        "cf_role": "mesh_topology",
        "long_name": "Gauss-Lobatto-Legendre points of the elements and the quads between them",
        "topology_dimension": np.int32(2),
        "node_coordinates": "lon lat",
        "face_node_connectivity": "face_nodes",
        "face_dimension": "face",
    })  # fmt: skip
    faces = dataset.createVariable("face_nodes", "i4", ("face", "corner"), fill_value=-1)
    faces.setncatts({
        "cf_role": "face_node_connectivity",
        "long_name": "corner nodes of each quad, anticlockwise",
        "start_index": np.int32(0),
    })  # fmt: skip
    sphere = {"grid_mapping_name": "latitude_longitude", "earth_radius": mesh.radius}
    dataset.createVariable("sphere", "i4").setncatts(sphere)


def _add_frames(dataset: netCDF4.Dataset, fields: Mapping[str, Mapping[str, str]]) -> None:
    _add_time(dataset, "time", "time").axis = "T"
    for name, attributes in fields.items():
        variable = dataset.createVariable(name, "f8", ("time", "node"), fill_value=np.nan)
        variable.setncatts({**attributes, **ON_NODES, **MEASURES})


def _add_time(dataset: netCDF4.Dataset, name: str, text: str) -> netCDF4.Variable[np.float64]:
    variable = dataset.createVariable(name, "f8", (name,))
    variable.setncatts({"long_name": text, **TIME})
    return variable


def _add_series(
    dataset: netCDF4.Dataset, series: Mapping[str, Mapping[str, str]], samples: int
) -> None:
    if not series:
        return
    dataset.createDimension(SERIES, samples)
    _add_time(dataset, SERIES, "time of the diagnostics")
    for name, own in series.items():
        if name in {*dataset.variables, *COORDINATES, *STATIC_FIELDS, *TOPOLOGY}:
            raise ValueError(f"a diagnostic cannot be called {name!r}: the file has that variable")
        text, units = DIAGNOSTICS.get(name, (name.replace("_", " "), "1"))
        variable = dataset.createVariable(name, "f8", (SERIES,), fill_value=np.nan)
        variable.setncatts({"long_name": text, "units": units, **own})


def _fill(
    dataset: netCDF4.Dataset,
    mesh: Mesh,
    quads: NDArray[np.integer[Any]],
    constants: Mapping[str, ArrayLike],
) -> None:
    dataset["mesh"][...] = dataset["sphere"][...] = 0  # their attributes are what counts
    dataset["face_nodes"][:] = quads
    places = zip(("lon", "lat"), (mesh.lon, mesh.lat), cell_corners(mesh), strict=True)
    for name, centre, corners in places:
        dataset[name][:], dataset[name + BOUNDS][:] = np.degrees(centre), np.degrees(corners)
    dataset["area"][:] = mesh.area
    for name in ("b", "f"):
        dataset[name][:] = constants.get(name, 0.0)


def attribute(value: object) -> Any:
    """A value as files can hold it: numbers, texts and rows of numbers; the rest as JSON."""
    if isinstance(value, (str, float, np.floating)):
        return value
    if isinstance(value, (int, np.integer, np.bool_)):
        number = int(value)
        return np.int32(number) if abs(number) < 2**31 else float(number)
    if isinstance(value, Sequence) and value and all(type(x) in (int, float) for x in value):
        return np.asarray(value, dtype=np.float64)
    if isinstance(value, Mapping):
        value = dict(value)
    return json.dumps(value, default=str)


def plain(values: Mapping[str, object]) -> dict[str, Any]:
    """Values as files can hold them, in types of Python: what xarray can write again."""
    return in_python({name: attribute(value) for name, value in values.items()})


def in_python(values: Mapping[str, Any]) -> dict[str, Any]:
    """The same without types of numpy."""
    return {k: v.tolist() if hasattr(v, "tolist") else v for k, v in values.items()}


def history(action: str, before: str = "") -> str:
    """A line for what is done now, above those of what was done before (CF-1.11, section 2.6.2)."""
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    line = f"{now} swe-sphere {__version__}: {action}"
    return f"{line}\n{before}" if before else line
