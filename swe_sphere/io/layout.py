"""Contents of an output file: dimensions, mesh, variables, attributes.

CF-1.11 (cfconventions.org) and UGRID-1.0 (ugrid-conventions.github.io): the GLL points are the
nodes of the mesh, the (np-1)^2 sub-quads of each element its faces, and data are defined at nodes.
For tools that support only cell values, the bounds of the coordinates define one cell per node.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from swe_sphere import __version__
from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY
from swe_sphere.settings.values import read_toml

if TYPE_CHECKING:
    import xarray as xr

VARIABLES: dict[str, Any] = read_toml(Path(__file__).with_name("variables.toml"))
"""Tables of variables.toml: attributes of variables, and the look of fields in pictures."""

TRACER = "q_"
"""Prefix of the names of variables with the mixing ratio of a tracer."""

BOUNDS = "_bnds"
"""Suffix of the names of the bounds of a coordinate."""
TOPOLOGY: tuple[str, ...] = (
    *VARIABLES["topology"], *(name + BOUNDS for name in VARIABLES["coordinates"]),
)  # fmt: skip
ON_NODES = {"mesh": "mesh", "location": "node", "coordinates": "lat lon", "grid_mapping": "sphere"}
MEASURES = {"cell_measures": "area: area"}
MISSING: dict[str, Any] = {"_FillValue": np.nan}
START = "2000-01-01"
"""Date of the start of a run in files."""
TIME = {
    "long_name": "time", "standard_name": "time", "units": f"seconds since {START} 00:00:00",
    "calendar": "proleptic_gregorian", "units_metadata": "leap_seconds: none",
}  # fmt: skip

MESH_ATTRIBUTES: tuple[str, ...] = ("ne", "np", "radius", "stretch", "centre", "spin")
"""Global attributes [m, degrees] from which `Mesh.build` rebuilds the mesh of the file."""

SERIES = "diagnostic_time"
"""The dimension of the series of diagnostics, and the variable with its times."""

FINITE = (*VARIABLES["frames"], "b", "surface", SERIES)
"""Variables that must not have missing values; mixing ratios must not either."""

SUMMARY = "summary"
"""The global attribute that states how the run ended, in JSON."""
SUMMARY_BYTES = 32 * 1024
"""Size of the space for the summary."""

LAYOUT_BYTES = 128
"""At least the bytes per node of a layout (120): lat, lon, their corners, area, b, f, one face."""


def frame_fields(tracers: Iterable[str] = ()) -> dict[str, dict[str, str]]:
    """Return the fields of every frame of a run with those tracers, and their attributes."""
    about = {x: {"long_name": f"mixing ratio of tracer {x}", "units": "1"} for x in tracers}
    return {**VARIABLES["frames"], **{f"{TRACER}{x}": each for x, each in about.items()}}


def frame_dataset(
    mesh: Mesh, fields: Mapping[str, Array], time: float, attributes: Mapping[str, Any],
    known: Mapping[str, Mapping[str, str]],
) -> "xr.Dataset":  # fmt: skip
    """Return copies of fields at `time` [s] on (time, node).

    fields (N,): by name, with b and f.  known: the wanted fields, with their attributes.
    """
    import xarray as xr

    data: dict[str, Any] = {}
    for name, about in known.items():
        value: Any = fields[name]
        if hasattr(value, "dims"):
            data[name] = value.assign_attrs(about).expand_dims("time")
        else:
            data[name] = (("time", "node"), value[None].copy(), {**about, **MEASURES})
    data |= _on_nodes(mesh, fields["b"], fields["f"])
    data["time"] = ("time", [time], {**TIME, "axis": "T"})
    about = plain({"Conventions": "CF-1.11", **attributes, **mesh_attributes(mesh)})
    return xr.Dataset(data, attrs=about).set_coords(["lat", "lon"])


def file_dataset(
    mesh: Mesh, attributes: Mapping[str, Any], bottom: ArrayLike, coriolis: ArrayLike,
    fields: Mapping[str, Mapping[str, str]], diagnostics: Mapping[str, Mapping[str, str]],
    samples: int, profiles: Mapping[str, "xr.DataArray"],
) -> "xr.Dataset":  # fmt: skip
    """Return a file without frames; the series come last and have space for `samples` samples.

    attributes: those of the run. bottom [m], coriolis [s-1]: a number or (N,). fields: the fields
    of every frame with their attributes. diagnostics: the series, with attributes if they are
    user-defined; without any series the file has no dimension for them. profiles: values of the
    fields that are no fields of the nodes.

    Raises ConfigError if the name of a series is already used in the file.
    """
    import xarray as xr

    data: dict[str, Any] = {"time": ("time", np.zeros(0), {**TIME, "axis": "T"})}
    for name, about in fields.items():
        if name in profiles:
            rows = profiles[name].assign_attrs({**MISSING, **about}).expand_dims(time=0)
            data[name] = rows.drop_vars(rows.coords)
            data |= {str(axis): of.variable for axis, of in rows.coords.items()}
            continue
        about = {**MISSING, **about, **ON_NODES, **MEASURES}
        data[name] = (("time", "node"), np.zeros((0, mesh.size)), about)
    data |= _on_nodes(mesh, bottom, coriolis)
    for name in VARIABLES["constants"]:
        data[name][2].update(ON_NODES)
    for name, corners in zip(("lon", "lat"), mesh.cell_corners(), strict=True):
        data[name][2]["bounds"] = name + BOUNDS
        data[name + BOUNDS] = (("node", "corner"), np.degrees(corners))
    topology = VARIABLES["topology"]
    zero = np.zeros((), np.int32)  # only the attributes count
    data["mesh"] = ((), zero, topology["mesh"])
    data["face_nodes"] = (("face", "corner"), mesh.quads(), topology["face_nodes"])
    data["sphere"] = ((), zero, topology["sphere"] | {"earth_radius": mesh.radius})
    unknown = np.full(samples, np.nan)
    if diagnostics:
        data[SERIES] = (SERIES, unknown, {**TIME, "long_name": "time of the diagnostics"})
    for name, own in diagnostics.items():
        if name in data:
            raise ConfigError(f"a diagnostic cannot be called {name!r}: the file has that variable")
        usual = {"long_name": name.replace("_", " "), "units": "1"}
        data[name] = (SERIES, unknown, {**MISSING, **VARIABLES["series"].get(name, usual), **own})
    about = {
        **attributes, "Conventions": "CF-1.11 UGRID-1.0",
        "source": f"swe_sphere {__version__}: spectral elements on the cubed sphere",
        SUMMARY: " " * SUMMARY_BYTES, **mesh_attributes(mesh),
    }  # fmt: skip
    return xr.Dataset(data, attrs=plain(about))


def mesh_attributes(mesh: Mesh) -> dict[str, Any]:
    """Return the attributes from which the mesh can be built again."""
    return {name: getattr(mesh, name) for name in MESH_ATTRIBUTES}


def _on_nodes(mesh: Mesh, bottom: ArrayLike, coriolis: ArrayLike) -> dict[str, Any]:
    """Return the coordinates of the nodes, and the constant fields."""
    lat, lon = np.degrees((mesh.lat, mesh.lon))
    values = {"lat": lat, "lon": lon, "b": bottom, "f": coriolis, "area": mesh.area}
    return {
        name: ("node", np.full(mesh.size, values[name], float), {**about})
        for name, about in (VARIABLES["coordinates"] | VARIABLES["constants"]).items()
    }


def plain(values: Mapping[str, object]) -> dict[str, Any]:
    """Return values as types that files can contain: numbers, texts, rows of numbers, or JSON."""
    return {name: _plain(value) for name, value in in_python(values).items()}


def _plain(value: Any) -> Any:
    if isinstance(value, (str, float)):
        return value
    if isinstance(value, int):
        return int(value) if abs(value) < 2**31 else float(value)
    if isinstance(value, Sequence) and value and all(type(x) in (int, float) for x in value):
        return [float(x) for x in value]
    return json.dumps(dict(value) if isinstance(value, Mapping) else value, default=str)


def in_python(values: Mapping[Any, Any]) -> dict[str, Any]:
    """Return values as Python types instead of numpy types."""
    return {str(k): v.tolist() if hasattr(v, "tolist") else v for k, v in values.items()}


def decode(data: "xr.Dataset", place: object) -> "xr.Dataset":
    """Return a dataset with its times in seconds since the start, from any units and calendar.

    place: file of the dataset, for messages. Raises ConfigError for units that cannot be read.
    """
    from netCDF4 import date2num, num2date  # slow to import

    for name in {"time", SERIES} & data.variables.keys():
        time: Any = data[name].variable
        about = {"units": "s", "calendar": "standard", **time.attrs}
        values, units, calendar = time.values, str(about["units"]), about["calendar"]
        try:
            if time.dtype.kind in "mM":  # timedelta64, datetime64
                start = np.datetime64(START) if time.dtype.kind == "M" else np.timedelta64(0)
                values, units = (values - start) / np.timedelta64(1, "s"), TIME["units"]
            elif time.dtype.kind == "O":  # dates of cftime
                values, units = date2num(values, TIME["units"]), TIME["units"]
            first_day = num2date([0, 1], f"days since {START}", calendar)
            known = units.replace("nano", "micro") + (" since " not in units) * f" since {START}"
            begin, end = date2num(first_day, known, calendar) * (1000 if "nano" in units else 1)
            found = (values.astype(float) - begin) * (DAY / (end - begin))
        except (AttributeError, TypeError, ValueError):
            raise ConfigError(
                f"cannot read {place}: times must be in seconds, hours or days, got {units!r}"
            ) from None
        data = data.assign_coords({name: (time.dims, found, about | {"units": TIME["units"]})})
    return data


def history(action: str, before: str = "") -> str:
    """Return a line for this action, above the lines `before` it (CF-1.11, section 2.6.2)."""
    line = f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ} swe-sphere {__version__}: {action}"
    return f"{line}\n{before}" if before else line
