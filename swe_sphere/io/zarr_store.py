"""Zarr stores of runs: written while a run goes on, and read as if they were netCDF files.

Zarr 2 (zarr-specs.readthedocs.io) with the names of dimensions in `_ARRAY_DIMENSIONS`, as xarray
has it, a chunk for each frame of each variable.  The consolidated metadata, one file that is
replaced at once, say how long everything is: they are written last, so that who reads by them sees
a frame of all variables or of none.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import netCDF4
import numpy as np
from numpy.typing import ArrayLike

from swe_sphere.errors import ConfigError
from swe_sphere.files.durable import part_of, write_whole
from swe_sphere.io.classic import FORMAT
from swe_sphere.io.growing import Growing

SUFFIX = ".zarr"
"""What the names of stores end with."""
DIMENSIONS = "_ARRAY_DIMENSIONS"
CONSOLIDATED, ATTRIBUTES = ".zmetadata", ".zattrs"


def is_store(path: Path) -> bool:
    """Whether there is a folder that holds a Zarr store."""
    return any((path / name).is_file() for name in (CONSOLIDATED, ".zgroup", "zarr.json"))


def engine(path: Path) -> Literal["zarr"] | None:
    """What xarray shall open a file with, which it can tell of all but stores of other names."""
    return "zarr" if is_store(path) else None


def check_zarr(path: Path) -> None:
    """ConfigError where the package is missing without which stores can neither be had nor read."""
    if find_spec("zarr") is None:
        raise ConfigError(f"{path} needs the package zarr: pip install zarr")


class GrowingStore(Growing):
    """A Zarr store; samples are on the disk from the next record on, or the next text."""

    def __init__(self, place: Path, series: str, _size: int) -> None:
        check_zarr(place)
        super().__init__(place, series, folder=True)
        self._samples: list[Mapping[str, float]] = []

    @property
    def recorded(self) -> frozenset[str]:
        """As `Growing`."""
        return frozenset(name for name, axes in self._axes.items() if axes[:1] == ("time",))

    def define(self, define: Callable[[netCDF4.Dataset], None]) -> None:
        """As `Growing`: the dataset is made in memory and copied."""
        import zarr

        group = zarr.open_group(part_of(self._place), mode="a", zarr_format=2)
        with netCDF4.Dataset("layout", "w", diskless=True, format=FORMAT) as dataset:
            dataset.set_auto_maskandscale(False)
            define(dataset)
            group.update_attributes(_plain(dataset))
            self._axes = {name: v.dimensions for name, v in dataset.variables.items()}
            for variable in dataset.variables.values():
                _copy(variable, group, self._series)
        zarr.consolidate_metadata(group.store, zarr_format=2)
        self._told = json.loads((part_of(self._place) / CONSOLIDATED).read_text())

    def add_record(self, values: Mapping[str, ArrayLike], sync: bool = True) -> None:
        """As `Growing`, but that the numbers may still be with the system."""
        for name, value in values.items():
            self._put(name, self.records, 1, value)
        self.records += 1
        if sync:
            self._commit()

    def add_sample(self, values: Mapping[str, float]) -> None:
        """As `Growing`; there is room for any number."""
        self._samples.append(dict(values))

    def set_text(self, name: str, text: str) -> None:
        """As `Growing`."""
        attributes = self._told["metadata"][ATTRIBUTES]
        attributes[name] = text
        write_whole(self._root / ATTRIBUTES, json.dumps(attributes))
        self._commit()

    def _put(self, name: str, begin: int, count: int, values: ArrayLike) -> None:
        """Numbers in the place of so many from that index on; ValueError if they do not fit."""
        import zarr

        array = zarr.open_array(self._root / name, mode="r+", zarr_format=2)
        numbers = np.reshape(values, (count, *array.shape[1:]))
        array.resize((begin + count, *array.shape[1:]))
        array[begin:] = numbers

    def _commit(self) -> None:
        """Make all that was written so far what the store holds."""
        names = [name for name, axes in self._axes.items() if axes == (self._series,)]
        if new := self._samples[self.samples :]:
            for name in names:
                self._put(name, self.samples, len(new), [sample[name] for sample in new])
            self.samples += len(new)
        lengths = dict.fromkeys(self.recorded, self.records) | dict.fromkeys(names, self.samples)
        for name, length in lengths.items():
            self._told["metadata"][f"{name}/.zarray"]["shape"][0] = length
        write_whole(self._root / CONSOLIDATED, json.dumps(self._told))

    @property
    def _root(self) -> Path:
        return self._place if self._in_place else part_of(self._place)


def _plain(holder: netCDF4.Dataset | netCDF4.Variable[Any]) -> dict[str, Any]:
    """The attributes as JSON has them."""
    found = {name: holder.getncattr(name) for name in holder.ncattrs() if name != "_FillValue"}
    return {k: v.tolist() if hasattr(v, "tolist") else v for k, v in found.items()}


def _copy(variable: netCDF4.Variable[Any], group: Any, series: str) -> None:
    """A variable with its values; none of those that grow."""
    name, shape, axes = variable.name, variable.shape, variable.dimensions
    grows = axes[:1] in (("time",), (series,))
    array = group.create_array(
        name,
        shape=(0, *shape[1:]) if grows else shape,
        chunks=(1, *shape[1:]) if axes[:1] == ("time",) else shape,
        dtype=variable.dtype.newbyteorder("="),
        fill_value=getattr(variable, "_FillValue", None),
        attributes=_plain(variable) | {DIMENSIONS: list(axes)},
    )
    if not grows:
        array[...] = variable[...]


class _Stored:
    """What has attributes, with the names that the netCDF library has."""

    _attributes: dict[str, Any]

    def ncattrs(self) -> list[str]:
        """Names of the attributes."""
        return [*self._attributes]

    def getncattr(self, name: str) -> Any:
        """One of them."""
        return self._attributes[name]


class StoredVariable(_Stored):
    """An array of a store with the names that variables of the netCDF library have."""

    def __init__(self, array: Any) -> None:
        self._array, self._attributes = array, dict(array.attrs)
        self.name, self.ndim, self.dtype = array.basename, array.ndim, array.dtype
        told = getattr(array.metadata, "dimension_names", None)  # those of Zarr 3
        self.dimensions = tuple(array.attrs.get(DIMENSIONS, told) or ())

    def __getitem__(self, key: Any) -> Any:
        return np.asarray(self._array[key])


class StoredDataset(_Stored):
    """A store, open for reading, with the names that datasets of the netCDF library have."""

    def __init__(self, path: Path) -> None:
        check_zarr(path)
        import zarr

        group = zarr.open_group(path, mode="r")
        self._attributes = dict(group.attrs)
        self.variables = {name: StoredVariable(array) for name, array in group.arrays()}
        axes = [v.dimensions for v in self.variables.values()]
        self.dimensions = dict.fromkeys(name for names in axes for name in names)

    def __getitem__(self, name: str) -> StoredVariable:
        return self.variables[name]
