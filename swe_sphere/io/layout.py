"""Contents of an output file before the first frame: dimensions, mesh, variables, attributes.

CF-1.11 (cfconventions.org) and UGRID-1.0 (ugrid-conventions.github.io): the GLL points are the
nodes of the mesh, the (np-1)^2 sub-quads of each element its faces, data live on the nodes.  For
tools that know values of cells alone, the bounds of the coordinates are those of a cell a node.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from swe_sphere import __version__
from swe_sphere.arrays import Array
from swe_sphere.mesh import Mesh

if TYPE_CHECKING:
    import xarray as xr

VARIABLES = tomllib.loads(Path(__file__).with_name("variables.toml").read_text("utf-8"))
"""Attributes of variables: frames, constants, coordinates, topology, series."""

TRACER = "q_"
"""Beginning of the names of variables with the mixing ratio of a tracer."""

BOUNDS = "_bnds"
"""Ending of the names of the bounds of a coordinate."""
TOPOLOGY = (*VARIABLES["topology"], *(name + BOUNDS for name in VARIABLES["coordinates"]))
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

MESH_ATTRIBUTES = ("ne", "np", "radius", "stretch", "centre", "spin")
"""Global attributes [m, degrees] from which `Mesh.build` makes the mesh of the file again."""

SERIES = "diagnostic_time"
"""The dimension of the series of diagnostics, and the variable with its times."""

SUMMARY = "summary"
"""The global attribute that states how the run ended, in JSON."""
SUMMARY_BYTES = 32 * 1024
"""Room for the summary."""

LAYOUT_BYTES = 128
"""Bytes per node of a layout: lat, lon, four corners of each, area, b, f, one face."""


class Variable(NamedTuple):
    """A variable of a file; without values it grows along its first dimension, in float64."""

    axes: tuple[str, ...]
    attributes: dict[str, Any]
    values: NDArray[Any] | None = None


class Layout(NamedTuple):
    """Contents of a file before the first frame."""

    sizes: dict[str, int]
    """Lengths of the dimensions; of those that grow, zero frames and the most samples."""
    attributes: dict[str, Any]
    variables: dict[str, Variable]


def frame_fields(tracers: Iterable[str] = ()) -> dict[str, dict[str, str]]:
    """Return the fields of every frame of a run with those tracers, and their attributes."""
    ratios = {
        f"{TRACER}{name}": {"long_name": f"mixing ratio of tracer {name}", "units": "1"}
        for name in tracers
    }
    return {**VARIABLES["frames"], **ratios}


def make_layout(
    mesh: Mesh,
    attributes: Mapping[str, Any],
    constants: Mapping[str, ArrayLike],
    fields: Mapping[str, Mapping[str, str]],
    diagnostics: Mapping[str, Mapping[str, str]],
    samples: int,
) -> Layout:
    """Describe a file.

    attributes: of the run.  constants: height of the bottom "b" [m] and Coriolis parameter "f"
    [s-1], a number or (N,).  fields: those of every frame with their attributes.
    diagnostics: the series, with attributes where they are user-defined; without any there is no
    dimension for them either.  samples: the most of each series.

    Raises ValueError if a series is called like something else in the file.
    """
    quads = mesh.quads()
    sizes = {"time": 0, "node": mesh.size, "face": len(quads), "corner": 4}
    variables = {"time": Variable(("time",), {"long_name": "time", **TIME, "axis": "T"})}
    missing: dict[str, Any] = {"_FillValue": np.nan}
    for name, own in fields.items():
        about = {**missing, **own, **ON_NODES, **MEASURES}
        variables[name] = Variable(("time", "node"), about)
    fixed = _topology(mesh, quads) | _on_nodes(mesh, constants)
    if diagnostics:
        sizes[SERIES] = samples
        about = {"long_name": "time of the diagnostics", **TIME}
        variables[SERIES] = Variable((SERIES,), about)
    for name, own in diagnostics.items():
        if name in variables or name in fixed:
            raise ValueError(f"a diagnostic cannot be called {name!r}: the file has that variable")
        plain = {"long_name": name.replace("_", " "), "units": "1"}
        about = {**missing, **VARIABLES["series"].get(name, plain), **own}
        variables[name] = Variable((SERIES,), about)
    about = {
        **attributes,
        "Conventions": "CF-1.11 UGRID-1.0",
        "source": f"swe_sphere {__version__}: spectral elements on the cubed sphere",
        SUMMARY: " " * SUMMARY_BYTES,
        **{name: getattr(mesh, name) for name in MESH_ATTRIBUTES},
    }
    return Layout(sizes, {k: attribute(value) for k, value in about.items()}, variables | fixed)


def _topology(mesh: Mesh, quads: NDArray[np.integer[Any]]) -> dict[str, Variable]:
    """Return the variables of UGRID, and the sphere that CF calls a grid mapping."""
    about = {
        name: {key: attribute(value) for key, value in table.items()}
        for name, table in VARIABLES["topology"].items()
    }
    zero = np.zeros((), np.int32)  # the attributes are what counts
    return {
        "mesh": Variable((), about["mesh"], zero),
        "face_nodes": Variable(("face", "corner"), about["face_nodes"], quads),
        "sphere": Variable((), about["sphere"] | {"earth_radius": mesh.radius}, zero),
    }


def _on_nodes(mesh: Mesh, constants: Mapping[str, ArrayLike]) -> dict[str, Variable]:
    """Return the coordinates of the nodes with the bounds of their cells, and constant fields."""
    values = {name: np.full(mesh.size, constants[name], float) for name in ("b", "f")}
    values["area"], found = mesh.area, {}
    places = zip(("lon", "lat"), (mesh.lon, mesh.lat), mesh.cell_corners(), strict=True)
    for name, centre, corners in places:
        about = VARIABLES["coordinates"][name] | {"bounds": name + BOUNDS}
        found[name] = Variable(("node",), about, np.degrees(centre))
        found[name + BOUNDS] = Variable(("node", "corner"), {}, np.degrees(corners))
    for name, about in VARIABLES["constants"].items():
        found[name] = Variable(("node",), about | ON_NODES, values[name])
    return found


def frame_dataset(
    mesh: Mesh,
    fields: Mapping[str, Array],
    time: float,
    attributes: Mapping[str, Any],
    own: Mapping[str, Mapping[str, str]],
) -> xr.Dataset:
    """Return fields on (time, node) as in a file; own: attributes of user-defined ones."""
    import xarray as xr

    tracers = [name.removeprefix(TRACER) for name in fields if name.startswith(TRACER)]
    known = frame_fields(tracers) | {name: dict(own[name]) for name in own if name in fields}
    data: dict[str, Any] = {
        name: (("time", "node"), fields[name][None], {**about, **MEASURES})
        for name, about in known.items()
    }
    constants = {"b": fields["b"], "f": fields["f"], "area": mesh.area}
    for name, about in VARIABLES["constants"].items():
        data[name] = ("node", constants[name], about)
    degrees = {"lat": np.degrees(mesh.lat), "lon": np.degrees(mesh.lon)}
    for name, about in VARIABLES["coordinates"].items():
        data[name] = ("node", degrees[name], about)
    data["time"] = ("time", [time], {"long_name": "time", "axis": "T", **TIME})
    parameters = {name: getattr(mesh, name) for name in MESH_ATTRIBUTES}
    about = plain({"Conventions": "CF-1.11", **attributes, **parameters})
    return xr.Dataset(data, attrs=about).set_coords([*degrees])


def attribute(value: object) -> Any:
    """Return a value as files can hold it: a number, text or row of numbers; others as JSON."""
    if isinstance(value, (str, float, np.floating)):
        return value
    if isinstance(value, (int, np.integer, np.bool_)):
        number = int(value)
        return np.int32(number) if abs(number) < 2**31 else float(number)
    if isinstance(value, Sequence) and value and all(type(x) in (int, float) for x in value):
        return np.asarray(value, dtype=np.float64)
    return json.dumps(dict(value) if isinstance(value, Mapping) else value, default=str)


def plain(values: Mapping[str, object]) -> dict[str, Any]:
    """Return values as files can hold them, in types of Python: what xarray can write again."""
    return in_python({name: attribute(value) for name, value in values.items()})


def in_python(values: Mapping[Any, Any]) -> dict[str, Any]:
    """Return values without types of numpy."""
    return {str(k): v.tolist() if hasattr(v, "tolist") else v for k, v in values.items()}


def history(action: str, before: str = "") -> str:
    """Return a line for this action, above those of earlier ones (CF-1.11, section 2.6.2)."""
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    line = f"{now} swe-sphere {__version__}: {action}"
    return f"{line}\n{before}" if before else line
