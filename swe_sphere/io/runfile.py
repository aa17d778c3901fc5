"""Frames at the nodes of a mesh: of a file of this program, read back, or of a state in memory."""

from __future__ import annotations

import errno
import json
import os
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.files.durable import check_moved
from swe_sphere.io.layout import MESH_ATTRIBUTES, SERIES, SUMMARY, in_python
from swe_sphere.io.scalar_fields import derive, evaluate
from swe_sphere.io.zarr_store import check_zarr, is_store
from swe_sphere.mesh import Interpolator, Mesh
from swe_sphere.planet import DAY

if TYPE_CHECKING:
    import xarray as xr

TOLERANCE = 1e-6 * DAY
"""Largest difference [s] between a frame's time and the requested one."""


@contextmanager
def reading(path: str | os.PathLike[str]) -> Iterator[xr.Dataset]:
    """Open a netCDF file or Zarr store, with values as they are stored.

    Raises ConfigError, in one line, for a fault of the file that shows in the block.
    """
    check_moved(Path(path))
    kind = engine(Path(path))
    if kind == "zarr":
        check_zarr(Path(path))
    elif not Path(path).is_file():
        raise ConfigError(f"there is no file {path}")
    import xarray as xr

    try:
        with warnings.catch_warnings():
            # a store of another program need not have consolidated metadata
            warnings.filterwarnings("ignore", "Failed to open Zarr store with consolidated")
            data = xr.open_dataset(path, engine=kind, decode_cf=False)
        with data:
            yield data
    except (OSError, RuntimeError, LookupError, AttributeError, ValueError, TypeError) as error:
        why = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
        why = f"it is damaged, cut short, or not a file of this kind ({why})"
        denied = not os.access(path, os.R_OK)
        why = os.strerror(errno.EACCES) if denied else why
        raise ConfigError(f"cannot read {path}: {why}") from error


def engine(path: Path) -> Literal["zarr", "netcdf4"]:
    """Return the engine of xarray that reads a file."""
    return "zarr" if is_store(path) else "netcdf4"


def check_length(path: Path) -> None:
    """Raise ValueError if a classic file ends before its data do, which netCDF does not report."""
    with path.open("rb") as file:
        if file.read(3) != b"CDF":
            return
    from scipy.io import netcdf_file

    with warnings.catch_warnings(action="ignore"), suppress(ValueError):
        netcdf_file(path, mmap=True).close()
        return
    raise ValueError("it ends within its data")


def table_in(text: str) -> dict[str, Any]:
    """Return a table in JSON; an empty one where a program was killed while it wrote it."""
    try:
        return dict(json.loads(text))
    except (ValueError, TypeError):
        return {}


def _frame_fields(data: xr.Dataset) -> list[str]:
    """Return the names of the variables that every frame has."""
    return [str(name) for name, v in data.variables.items() if v.dims == ("time", "node")]


class Nodal(ABC):
    """Frames at the nodes of a mesh: points, area weights, and values anywhere on the sphere."""

    attributes: dict[str, Any]
    """Attributes of the run."""
    about: Mapping[str, Mapping[str, Any]]
    """Attributes of the variables that a frame holds, as far as they are known."""
    bottom: Array
    """Height of the bottom (N,) [m]."""
    mesh: Mesh

    @property
    def title(self) -> str:
        """Title of the run."""
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
        """Fields (N,) at time [s] (None: the last): b, h, u, v, vorticity, divergence, q_NAME, and
        user-defined ones."""

    def values(self, field: str, time: float | None = None) -> Array:
        """A field at the nodes: (N,), or (2, N) for "wind"."""
        return derive(self.frame(time), field)

    def at(self, field: str, lon: Array, lat: Array, time: float | None = None) -> Array:
        """A field at any points lon, lat (M,) [rad]: (M,), or (2, M) for "wind"."""
        return evaluate(Interpolator(self.mesh, lon, lat), self.frame(time), field)


def nearest_time(path: Path, times: Array, time: float | None) -> float:
    """Return the time [s] of the frame at time, of the last one for None; ConfigError if none."""
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
        with reading(path) as data:
            if self.path.is_file():
                check_length(self.path)
            found = in_python(data.attrs)
            if SUMMARY not in found:
                raise ConfigError(
                    f"cannot read {self.path}: it is no file of a run of swe_sphere, or damaged"
                )
            told = table_in(found[SUMMARY])
            new = {k: value for k, value in told.items() if k == "days" or k not in found}
            self.attributes = found | new
            """The global attributes, and by its names what the summary says more: how many days."""
            self._mesh_arguments = {name: found[name] for name in MESH_ATTRIBUTES}
            self.about = {name: in_python(data[name].attrs) for name in _frame_fields(data)}
            self.times: Array = data["time"].values
            self.bottom: Array = data["b"].values

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
        """Title of the run, or the name of the file."""
        return super().title or self.path.stem

    def nearest(self, time: float | None) -> float:
        """As `Nodal`."""
        return nearest_time(self.path, self.times, time)

    def frame(self, time: float | None = None) -> dict[str, Array]:
        """As `Nodal`."""
        index = int(np.argmin(np.abs(self.times - self.nearest(time))))
        with reading(self.path) as data:
            fields = {name: data[name][index].values for name in _frame_fields(data)}
        return {"b": self.bottom} | fields

    def series(self) -> tuple[Array, dict[str, Array]]:
        """Times (D,) [s] of the diagnostics and each of them (D,), NaN where missing."""
        with reading(self.path) as data:
            variables = data.variables.items()
            found = {str(name): v.values for name, v in variables if v.dims == (SERIES,)}
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
