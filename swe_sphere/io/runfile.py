"""Frames at the nodes of a mesh: of a file of this program, read back, or of a state in memory."""

from __future__ import annotations

import errno
import json
import os
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import netCDF4
import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.files.durable import check_moved
from swe_sphere.io.classic import check_length
from swe_sphere.io.layout import (
    COORDINATES,
    MEASURES,
    MESH_ATTRIBUTES,
    SERIES,
    STATIC_FIELDS,
    SUMMARY,
    TIME,
    TRACER,
    frame_fields,
    in_python,
    plain,
)
from swe_sphere.io.scalar_fields import derive, evaluate
from swe_sphere.io.zarr_store import StoredDataset, StoredVariable, is_store
from swe_sphere.mesh import Interpolator, Mesh
from swe_sphere.planet import DAY

if TYPE_CHECKING:
    import xarray as xr


Dataset = netCDF4.Dataset | StoredDataset

TOLERANCE = 1e-6 * DAY
"""How far [s] a frame may be from the time asked for."""


@contextmanager
def reading(path: str | os.PathLike[str]) -> Iterator[Dataset]:
    """An open netCDF file or Zarr store; ConfigError, in one line, for what is wrong with it in
    the block."""
    store = is_store(Path(path))
    check_moved(Path(path))
    if not (store or Path(path).is_file()):
        raise ConfigError(f"there is no file {path}")
    try:
        if store:
            yield StoredDataset(Path(path))
            return
        with netCDF4.Dataset(path) as dataset:
            dataset.set_auto_maskandscale(False)
            yield dataset
    except (OSError, RuntimeError, LookupError, AttributeError, ValueError, TypeError) as error:
        raise ConfigError(f"cannot read {path}: {_cause(path, error)}") from error


def _cause(path: str | os.PathLike[str], error: Exception) -> str:
    if not os.access(path, os.R_OK):
        return os.strerror(errno.EACCES)
    why = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
    return f"it is damaged, cut short, or not a file of this kind ({why})"


def attributes(of: Dataset | netCDF4.Variable[Any] | StoredVariable) -> dict[str, Any]:
    """The (global) attributes as plain numbers, texts and lists of numbers."""
    return in_python({name: of.getncattr(name) for name in of.ncattrs()})


def table_in(text: str) -> dict[str, Any]:
    """A table in JSON; nothing of one whose program was killed while it wrote it."""
    try:
        return dict(json.loads(text))
    except (ValueError, TypeError):
        return {}


def _frame_fields(dataset: Dataset) -> list[str]:
    """Names of the variables that every frame has."""
    variables = dataset.variables.items()
    return [name for name, variable in variables if variable.dimensions == ("time", "node")]


class Nodal(ABC):
    """Frames at the nodes of a mesh: points, area weights, and values anywhere on the sphere."""

    attributes: dict[str, Any]
    """What is known of the run."""
    about: Mapping[str, Mapping[str, Any]]
    """Attributes of the variables that a frame holds, as far as they are known."""
    bottom: Array
    """Height of the bottom (N,) [m]."""
    mesh: Mesh

    @property
    def title(self) -> str:
        """What was run."""
        return str(self.attributes.get("title", self.attributes.get("scene", "")))

    @property
    def points(self) -> tuple[Array, Array]:
        """Longitude and latitude (N,) [rad] of the nodes."""
        return self.mesh.lon, self.mesh.lat

    @property
    def area(self) -> Array:
        """Area weights (N,) [m2] of the nodes."""
        return self.mesh.area

    @abstractmethod
    def nearest(self, time: float | None) -> float:
        """The time [s] of the frame at time, of the last one for None; ConfigError if none."""

    @abstractmethod
    def frame(self, time: float | None = None) -> dict[str, Array]:
        """Fields (N,) at time [s] (None: the last): b, h, u, v, vorticity, divergence, q_NAME."""

    def values(self, field: str, time: float | None = None) -> Array:
        """A field at the nodes: (N,), or (2, N) for "wind"."""
        return derive(self.frame(time), field)

    def at(self, field: str, lon: Array, lat: Array, time: float | None = None) -> Array:
        """A field at any points lon, lat (M,) [rad]: (M,), or (2, M) for "wind"."""
        return evaluate(Interpolator(self.mesh, lon, lat), self.frame(time), field)


def nearest_time(path: Path, times: Array, time: float | None) -> float:
    """That of the times [s] of a file's frames, the last one for None; ConfigError if none."""
    if times.size == 0:
        raise ConfigError(f"{path} holds no frame yet")
    if time is None:
        return float(times[-1])
    found = float(times[np.argmin(np.abs(times - time))])
    if not abs(found - time) <= TOLERANCE:
        days = ", ".join(f"{t / DAY:g}" for t in times[-8:])
        raise ConfigError(
            f"{path} holds no frame at day {time / DAY:g}: the last ones are at day {days}"
        )
    return found


class RunFile(Nodal):
    """A file written by `FrameWriter`: points, area weights and values at the nodes of its mesh.

    Raises ConfigError if the file is missing, damaged, or of another kind.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        with reading(path) as dataset:
            if self.path.is_file():
                check_length(self.path)
            found = attributes(dataset)
            if SUMMARY not in found:
                raise ConfigError(
                    f"cannot read {self.path}: it is no file of a run of swe_sphere, or damaged"
                )
            told = table_in(found[SUMMARY])
            new = {k: value for k, value in told.items() if k == "days" or k not in found}
            self.attributes = found | new
            """The global attributes, and by its names what the summary says more: how many days."""
            self._mesh_arguments = {name: found[name] for name in MESH_ATTRIBUTES}
            self.about = {name: attributes(dataset[name]) for name in _frame_fields(dataset)}
            self.times: Array = dataset["time"][:]
            self.bottom: Array = dataset["b"][:]

    @cached_property
    def mesh(self) -> Mesh:  # type: ignore[override]
        """The mesh, made again from the attributes of the file."""
        if self.bottom.ndim != 1:
            raise ConfigError(f"{self.path} is on a grid already: give the file of a run")
        mesh = Mesh.build(**self._mesh_arguments)
        if mesh.size != self.bottom.size:
            raise ConfigError(f"cannot read {self.path}: its mesh does not fit its attributes")
        return mesh

    @property
    def title(self) -> str:
        """What was run."""
        return super().title or self.path.stem

    def nearest(self, time: float | None) -> float:
        """The time [s] of the frame at time, of the last one for None; ConfigError if none."""
        return nearest_time(self.path, self.times, time)

    def frame(self, time: float | None = None) -> dict[str, Array]:
        """Fields (N,) at time [s] (None: the last): b, h, u, v, vorticity, divergence, q_NAME, and
        those of the user's own diagnostics."""
        index = int(np.argmin(np.abs(self.times - self.nearest(time))))
        with reading(self.path) as dataset:
            names = _frame_fields(dataset)
            return {"b": self.bottom} | {name: dataset[name][index] for name in names}

    def series(self) -> tuple[Array, dict[str, Array]]:
        """Times (D,) [s] of the diagnostics and each of them (D,), NaN where missing."""
        with reading(self.path) as dataset:
            found = {
                name: variable[:]
                for name, variable in dataset.variables.items()
                if variable.dimensions == (SERIES,)
            }
        return found.pop(SERIES, np.zeros(0)), found


class Frame(Nodal):
    """One state at the nodes of a mesh; fields: (N,) each, b among them, at time [s].

    attributes: of the run; about: of fields.
    """

    def __init__(
        self,
        mesh: Mesh,
        fields: Mapping[str, Array],
        time: float,
        attributes: Mapping[str, Any],
        about: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> None:
        self.mesh, self.bottom, self.attributes = mesh, fields["b"], dict(attributes)
        self.about = about or {}
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
        name: (("time", "node"), fields[name][None], {**about, **MEASURES})
        for name, about in known.items()
    }
    for name, values in {"b": fields["b"], "f": fields["f"], "area": mesh.area}.items():
        data[name] = ("node", values, STATIC_FIELDS[name])
    degrees = {"lat": np.degrees(mesh.lat), "lon": np.degrees(mesh.lon)}
    points = {name: ("node", degrees[name], about) for name, about in COORDINATES.items()}
    about_time = {"long_name": "time", "axis": "T", **TIME}
    parameters = {name: getattr(mesh, name) for name in MESH_ATTRIBUTES}
    about = {"Conventions": "CF-1.11", **attributes, **parameters}
    return xr.Dataset(data, {"time": ("time", [time], about_time), **points}, plain(about))
