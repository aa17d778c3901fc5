"""Zarr stores of runs: written by xarray during a run, and read as if they were netCDF files.

Zarr 2 (zarr-specs.readthedocs.io), one chunk for each frame of each variable.  The consolidated
metadata, a single file that is replaced atomically, hold the length of every variable.  They are
written last, so that a reader finds a frame of all variables or of none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import netCDF4
import numpy as np
from numpy.typing import ArrayLike

from swe_sphere.errors import ConfigError
from swe_sphere.files.durable import part_of
from swe_sphere.io.classic import FORMAT
from swe_sphere.io.growing import Growing

SUFFIX = ".zarr"
"""What the names of stores end with."""
DIMENSIONS = "_ARRAY_DIMENSIONS"


def is_store(path: Path) -> bool:
    """Whether there is a folder that holds a Zarr store."""
    return any((path / name).is_file() for name in (".zmetadata", ".zgroup", "zarr.json"))


def engine(path: Path) -> Literal["zarr"] | None:
    """What xarray shall open a file with, which it can tell of all but stores of other names."""
    return "zarr" if is_store(path) else None


def check_zarr(path: Path) -> None:
    """ConfigError where the package is missing without which stores can neither be had nor read."""
    if find_spec("zarr") is None:
        raise ConfigError(f"{path} needs the package zarr: pip install zarr")


class GrowingStore(Growing):
    """A Zarr store with the methods of `GrowingFile`, appended to by xarray.

    Samples are stored with the next record or text; there is room for any number of them.
    """

    def __init__(self, place: Path, series: str, _size: int) -> None:
        check_zarr(place)
        super().__init__(place, series, folder=True)
        self._samples: list[Mapping[str, float]] = []

    def define(self, define: Callable[[netCDF4.Dataset], None]) -> None:
        """As `GrowingFile`; the dataset is defined in memory and copied."""
        import xarray as xr

        with netCDF4.Dataset("layout", "w", diskless=True, format=FORMAT) as dataset:
            define(dataset)
            source = xr.backends.NetCDF4DataStore(dataset)  # type: ignore[no-untyped-call]
            layout = xr.open_dataset(source, decode_cf=False).load()
        self._attributes = layout.attrs
        self._axes = {str(name): variable.dims for name, variable in layout.variables.items()}
        self.recorded = frozenset(n for n, axes in self._axes.items() if "time" in axes)
        chunks: dict[Any, int] = {**layout.sizes, "time": 1}
        encoding = {n: {"chunks": [chunks[x] for x in axes]} for n, axes in self._axes.items()}
        empty = layout.isel({self._series: slice(0)}, missing_dims="ignore")
        empty.to_zarr(self._root, zarr_format=2, consolidated=True, encoding=encoding)

    def add_record(self, values: Mapping[str, ArrayLike], sync: bool = True) -> None:
        """As `GrowingFile`, but the system may not have written the numbers to the disk yet."""
        if sync:
            self._append_samples()
        shapes = {name: (1, -1)[: len(self._axes[name])] for name in values}
        self._append("time", {name: np.reshape(x, shapes[name]) for name, x in values.items()})
        self.records += 1

    def add_sample(self, values: Mapping[str, float]) -> None:
        """As `GrowingFile`."""
        self._samples.append(dict(values))

    def set_text(self, name: str, text: str) -> None:
        """As `GrowingFile`."""
        import zarr

        self._append_samples()
        self._attributes[name] = text
        group = zarr.open_group(self._root, mode="r+", zarr_format=2)
        group.update_attributes({name: text})
        zarr.consolidate_metadata(group.store, zarr_format=2)

    def _append_samples(self) -> None:
        if new := self._samples[self.samples :]:
            self._append(self._series, {n: [sample[n] for sample in new] for n in new[0]})
            self.samples += len(new)

    def _append(self, axis: str, values: Mapping[str, ArrayLike]) -> None:
        """Append to all variables along an axis: consolidating makes the new length known."""
        import xarray as xr

        arrays = {name: (self._axes[name], x) for name, x in values.items()}
        new = xr.Dataset(arrays, attrs=self._attributes)
        new.to_zarr(self._root, append_dim=axis, consolidated=True)

    @property
    def _root(self) -> Path:
        return self._place if self._in_place else part_of(self._place)


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
