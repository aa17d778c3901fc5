"""A state in memory as a frame of a run's file: for xarray, and for pictures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.io.layout import MESH_ATTRIBUTES, ON_NODES, STATIC_FIELDS, TRACER, frame_fields
from swe_sphere.io.runfile import Nodal
from swe_sphere.mesh import Mesh

if TYPE_CHECKING:
    import xarray as xr


class Frame(Nodal):
    """One state at the nodes of a mesh; fields: (N,) each, b among them, at time [s]."""

    def __init__(
        self, mesh: Mesh, fields: Mapping[str, Array], time: float, attributes: Mapping[str, Any]
    ) -> None:
        self.mesh, self.bottom, self.attributes = mesh, fields["b"], dict(attributes)
        self._fields, self._time = dict(fields), time

    def nearest(self, time: float | None) -> float:
        """The one time there is [s]."""
        return self._time

    def frame(self, time: float | None = None) -> dict[str, Array]:
        """All fields (N,)."""
        return self._fields


def frame_dataset(
    mesh: Mesh,
    fields: Mapping[str, Array],
    time: float,
    attributes: Mapping[str, Any],
    own: Mapping[str, Mapping[str, str]],
) -> xr.Dataset:
    """The fields on (time, node) with their units, as in a file; own: attributes of the user's."""
    import xarray as xr

    tracers = [name.removeprefix(TRACER) for name in fields if name.startswith(TRACER)]
    known = frame_fields(tracers) | {name: dict(own[name]) for name in own if name in fields}
    data: dict[str, Any] = {
        name: (("time", "node"), fields[name][None], {**about, **ON_NODES})
        for name, about in known.items()
    }
    for name, values in {"b": fields["b"], "f": fields["f"], "area": mesh.area}.items():
        data[name] = ("node", values, STATIC_FIELDS[name])
    degrees = {"lat": np.degrees(mesh.lat), "lon": np.degrees(mesh.lon)}
    units = {"lat": "degrees_north", "lon": "degrees_east"}
    points = {name: ("node", values, {"units": units[name]}) for name, values in degrees.items()}
    about_time = {"units": "s", "long_name": "time since the start"}
    coordinates = {"time": ("time", [time], about_time), **points}
    parameters = {name: getattr(mesh, name) for name in MESH_ATTRIBUTES}
    return xr.Dataset(data, coordinates, {**attributes, **parameters})
