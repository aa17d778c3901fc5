"""Sources of fields: files of this program, read back and checked, and states in memory."""

import errno
import json
import os
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, Field, PositiveFloat, ValidationError
from scipy.io import netcdf_file

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError, SweError
from swe_sphere.files.durable import check_moved, translate_errors
from swe_sphere.io.growing import check_zarr, is_store
from swe_sphere.io.layout import FINITE, MESH_ATTRIBUTES, SERIES, SUMMARY, TRACER, decode, in_python
from swe_sphere.io.scalar_fields import Sampler, derive, evaluate
from swe_sphere.mesh import Interpolator, Mesh
from swe_sphere.mesh.sphere import position
from swe_sphere.planet import DAY
from swe_sphere.settings.values import place_and_complaint, validate

if TYPE_CHECKING:
    import xarray as xr

Count = Annotated[int, Field(ge=0, lt=2**53)]


class RunAttributes(BaseModel, strict=True, allow_inf_nan=False):
    """Attributes of a run that are read again, if present; other attributes are not checked."""

    ne: Count = 1
    np: Count = 3
    radius: PositiveFloat = 1.0
    stretch: PositiveFloat = 1.0
    centre: Annotated[list[float], Field(min_length=2, max_length=2)] = [0.0, 0.0]
    spin: float = 0.0
    dt: PositiveFloat = 1.0
    steps_at_once: Annotated[Count, Field(ge=1)] = 1
    start_step: Count = 0
    time_offset: float = 0.0
    scene: str = ""
    title: str = ""
    run_id: str = ""
    history: str = ""
    code: str = ""
    summary: str = ""
    identity: str = ""
    configuration: str = ""
    plot_field: str = ""


class CheckpointHeader(BaseModel, strict=True, allow_inf_nan=False):
    """Header of a checkpoint; other entries are ignored."""

    steps: Count
    arrays: list[str]
    attributes: RunAttributes


def mesh_of(attributes: Mapping[str, Any], data: "xr.Dataset", failure: str) -> Mesh:
    """Return the mesh of a dataset of a run with these attributes.

    Raises ConfigError, which begins with `failure`, if an attribute is unfit, or the mesh is of
    another size or has other nodes. The size is checked before the mesh is built.
    """
    values = {name: attributes[name] for name in MESH_ATTRIBUTES}
    ne, order = values["ne"], values["np"]
    try:
        validate(RunAttributes, attributes)
        if (expected := 6 * (ne * (order - 1)) ** 2 + 2) != (nodes := data.sizes["node"]):
            raise ConfigError(
                f"ne={ne} and np={order} make {expected} nodes, but the file has {nodes}: it holds"
                " a part of the nodes, or is damaged"
            )
        mesh = Mesh.build(**values)
        angles = [np.radians(data[x].values) for x in ("lon", "lat") if x in data.variables]
        near = 0.1 * mesh.spacing()[0] / mesh.radius  # coordinates may be rounded
        if len(angles) == 2 and not np.allclose(position(*angles), mesh.xyz, rtol=0.0, atol=near):
            raise ConfigError(
                "its nodes (lat, lon) are in another order than those of the mesh, or at other"
                " places: keep the order in which the run wrote them"
            )
        return mesh
    except (ConfigError, ValueError) as error:
        raise ConfigError(f"{failure}: {error}") from None


TIME_TOLERANCE = 1e-6 * DAY
"""Largest difference [s] between a frame's time and the requested one."""


@contextmanager
def reading(path: str | os.PathLike[str]) -> Iterator["xr.Dataset"]:
    """Open a netCDF file or Zarr store, with packed values unpacked and times in seconds.

    Raises ConfigError, in one line, for a fault of the file that appears in the block.
    """
    import xarray as xr  # takes half a second

    with translate_errors(f"cannot read {path}"):
        check_moved(Path(path))
        if (kind := engine(Path(path))) == "zarr":
            check_zarr(Path(path))
        elif Path(path).is_dir():
            raise ConfigError(f"{path} is a folder: give the name of a file in it")
        elif not Path(path).is_file():
            raise ConfigError(f"there is no file {path}")
    try:
        with warnings.catch_warnings():
            # stores of other programs may lack consolidated metadata
            warnings.filterwarnings("ignore", "Failed to open Zarr store with consolidated")
            data = xr.open_dataset(path, engine=kind, decode_times=False, decode_coords=False)
        with data:
            yield decode(data, path)
    except SweError:
        raise
    except ValidationError as error:
        raise ConfigError(f"cannot read {path}: {place_and_complaint(error)}") from None
    except Exception as error:  # decoders of damaged data raise errors of all kinds
        why = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
        why = f"it is damaged, cut short, or not a file of this kind ({why})"
        why = why if os.access(path, os.R_OK) else os.strerror(errno.EACCES)
        raise ConfigError(f"cannot read {path}: {why}") from error


def engine(path: Path) -> Literal["zarr", "netcdf4"]:
    """Return the engine of xarray that reads a file."""
    return "zarr" if is_store(path) else "netcdf4"


def check_length(path: Path) -> None:
    """Raise ValueError if a classic file ends before its data do, which netCDF does not report."""
    with warnings.catch_warnings(action="ignore"), suppress(TypeError):  # netCDF-4
        try:
            netcdf_file(path, mmap=True).close()
        except ValueError:
            raise ValueError("it ends within its data") from None


def read_values(path: Path, name: str, variable: "xr.Variable") -> Array:
    """Return the values of a variable; raises ConfigError if a known field lacks a value."""
    values: Array = variable.values
    needed = name in FINITE or name.startswith(TRACER)
    if needed and (missing := np.count_nonzero(~np.isfinite(values))):
        raise ConfigError(
            f"{path} is incomplete or damaged: {missing} values of {name} are missing or not finite"
        )
    return values


def table_in(text: str) -> dict[str, Any]:
    """Return a table in JSON; an empty one for other text, as a killed program may leave."""
    try:
        return dict(json.loads(text))
    except (ValueError, TypeError, RecursionError):
        return {}


class Source(ABC):
    """Fields at points of the sphere, at one or several times."""

    path = Path()
    """File of the fields, if there is one."""
    attributes: dict[str, Any]
    """Attributes of the run."""
    about: Mapping[str, Mapping[str, Any]]
    """Attributes of the variables in a frame, as far as they are known."""
    times: Array
    """Times (T,) [s] of the frames."""
    points: tuple[Array, Array]
    """Longitude and latitude (N,) [rad] of the points."""
    area: Array
    """Area weights (N,) of the points, in any unit."""

    @property
    def title(self) -> str:
        """Title of the run, or the name of the file."""
        return str(self.attributes.get("title", self.attributes.get("scene", self.path.stem)))

    @abstractmethod
    def frame(self, time: float | None = None) -> dict[str, Array]:
        """Return the stored fields (N,) at time [s] (None: the last) by name; of a run also b."""

    def state(self, time: float | None = None) -> dict[str, Array]:
        """Return the fields of `frame`, and f and area if the source contains them."""
        return self.frame(time)

    @abstractmethod
    def sampler(self, lon: Array, lat: Array) -> Sampler | None:
        """Return a sampler that evaluates fields (N,) and winds at points lon, lat (M,) [rad].

        At its own points a `Nodal` returns None, so that equal states have no error.
        """

    def index(self, time: float | None) -> int:
        """Return the index of the frame at time [s], of the last for None; ConfigError if none."""
        if self.times.size == 0:
            raise ConfigError(f"{self.path} holds no frame yet")
        if time is None:
            return self.times.size - 1
        found = int(np.argmin(np.abs(self.times - time)))
        if not abs(self.times[found] - time) <= TIME_TOLERANCE:
            days = ", ".join(f"{t / DAY:g}" for t in self.times[-8:])
            raise ConfigError(
                f"{self.path} holds no frame at day {time / DAY:g}: the last ones are at day {days}"
            )
        return found

    def frame_time(self, time: float | None) -> float:
        """Return the time [s] of the frame at time, of the last for None; ConfigError if none."""
        return float(self.times[self.index(time)])

    def values(self, name: str, time: float | None = None) -> Array:
        """Return a field at the points: (N,), or (2, N) for "wind"."""
        return derive(self.state(time), name)

    def at(self, name: str, lon: Array, lat: Array, time: float | None = None) -> Array:
        """Return a field at any points lon, lat (M,) [rad]: (M,), or (2, M) for "wind"."""
        return evaluate(self.sampler(lon, lat), self.state(time), name)


class Nodal(Source):
    """Fields at the nodes of a mesh."""

    mesh: Mesh
    bottom: Array
    """Height of the bottom (N,) [m]."""

    @property
    def points(self) -> tuple[Array, Array]:  # type: ignore[override]
        return self.mesh.lon, self.mesh.lat

    @property
    def area(self) -> Array:  # type: ignore[override]
        return self.mesh.area

    def sampler(self, lon: Array, lat: Array) -> Sampler | None:
        here = np.array_equal(lon, self.mesh.lon) and np.array_equal(lat, self.mesh.lat)
        return None if here else Interpolator(self.mesh, lon, lat)


class RunFile(Nodal):
    """A file of `FrameWriter`; ConfigError if it is missing, damaged, or of another kind."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        with reading(path) as data:
            if self.path.is_file():
                check_length(self.path)
            found = in_python(data.attrs)
            RunAttributes.model_validate(found)
            if SUMMARY not in found:
                raise ConfigError(
                    f"cannot read {self.path}: it is not a file of a run, or it is damaged"
                )
            stated = table_in(found[SUMMARY])
            new = {k: value for k, value in stated.items() if k == "days" or k not in found}
            self.attributes = found | new
            """The global attributes, with `days` and further entries of the summary."""
            if lacking := {*MESH_ATTRIBUTES} - found.keys():
                raise ValueError(f"it lacks {', '.join(sorted(lacking))}")
            fields = [str(name) for name, v in data.variables.items() if v.dims == ("time", "node")]
            for name in {*fields, "b", "time"} & {*data.variables}:
                if data[name].dtype.kind not in "fiu":
                    raise ValueError(f"{name} holds no numbers")
            self.about = {name: in_python(data[name].attrs) for name in fields}
            series = [name for name, v in data.variables.items() if v.dims == (SERIES,)]
            self.about_series = {str(name): in_python(data[name].attrs) for name in series}
            """Attributes of the series of diagnostics."""
            self.times = data["time"].values
            if not (self.times.ndim == 1 and np.all(np.diff(self.times, prepend=-1.0) > 0.0)):
                raise ValueError("its times do not increase")
            self._constants = {  # time is one of their dimensions after xr.concat
                x: read_values(self.path, x, data[x].variable.isel(time=0, missing_dims="ignore"))
                for x in ("b", "f", "area") if x in data
            }  # fmt: skip
            may_lack = {} if "node" in data.dims else {"b": np.zeros((0, 0))}
            self.bottom = (may_lack | self._constants)["b"]

    @cached_property
    def mesh(self) -> Mesh:  # type: ignore[override]
        """The mesh, rebuilt from the attributes of the file."""
        if self.bottom.ndim != 1:
            raise ConfigError(f"{self.path} is already on a grid: give the file of a run")
        with reading(self.path) as data:
            return mesh_of(self.attributes, data, f"cannot read {self.path}")

    def frame(self, time: float | None = None) -> dict[str, Array]:
        index = self.index(time)
        with reading(self.path) as data:
            found = {x: read_values(self.path, x, data[x][index].variable) for x in self.about}
            return {"b": self.bottom} | found

    def state(self, time: float | None = None) -> dict[str, Array]:
        return self.frame(time) | self._constants

    def series(self) -> tuple[Array, dict[str, Array]]:
        """Return the times (D,) [s] of the diagnostics, and each series (D,), NaN where missing."""
        with reading(self.path) as data:
            found = {x: read_values(self.path, x, data[x].variable) for x in self.about_series}
        return found.pop(SERIES, np.zeros(0)), found
