"""Zarr stores of runs, which grow as netCDF files do.

Zarr 2 (zarr-specs.readthedocs.io), one chunk for each frame of each variable.  The consolidated
metadata, a single file that is replaced atomically, hold the length of every variable.  They are
written last, so that a reader finds a frame of all variables or of none.  The lengths in the
metadata of single arrays may be ahead after a failed write, and nothing here reads them.
"""

import json
from collections.abc import Mapping
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from swe_sphere.errors import ConfigError
from swe_sphere.files.durable import part_of, sync, write_whole
from swe_sphere.io.growing import Growing
from swe_sphere.io.layout import SERIES, SUMMARY

SUFFIX = ".zarr"
"""Ending of the names of stores."""
CONSOLIDATED, ATTRIBUTES = ".zmetadata", ".zattrs"


def is_store(path: Path) -> bool:
    """Return whether a folder holds a Zarr store."""
    return any((path / name).is_file() for name in (CONSOLIDATED, ".zgroup", "zarr.json"))


def check_zarr(path: Path) -> None:
    """Raise ConfigError where the package is missing that reads and writes stores."""
    if find_spec("zarr") is None:
        raise ConfigError(f"{path} needs the package zarr: pip install zarr")


class GrowingStore(Growing):
    """A Zarr store with the methods of `GrowingFile`.

    Samples are stored with the next record or text; there is room for any number of them.  What a
    failed write leaves behind is never counted, and the next write replaces it.
    """

    def __init__(self, place: Path) -> None:
        check_zarr(place)
        super().__init__(place, folder=True)
        self._samples: list[Mapping[str, float]] = []
        self._unsynced: set[str] = set()

    def define(self, data: xr.Dataset) -> None:
        sizes = {**data.sizes, "time": 1}
        self._axes = {str(name): variable.dims for name, variable in data.variables.items()}
        data.isel({SERIES: slice(0)}, missing_dims="ignore").to_zarr(
            self._root, zarr_format=2, consolidated=True,
            encoding={n: {"chunks": [sizes[x] for x in axes]} for n, axes in self._axes.items()},
        )  # fmt: skip
        self._consolidated = json.loads((self._root / CONSOLIDATED).read_text())
        self._unsynced = {str(path.relative_to(self._root)) for path in self._root.rglob("*")}

    def add_record(self, values: Mapping[str, ArrayLike], sync: bool = True) -> None:
        """As `GrowingFile`; without sync, readers do not find the record yet."""
        if sync:
            self._append_samples()
        self._put(values, self.records, 1)
        if sync:
            self._commit(self.records + 1)
        self.records += 1

    def add_sample(self, values: Mapping[str, float]) -> None:
        self._samples.append(dict(values))

    def set_summary(self, text: str) -> None:
        self._append_samples()
        attributes = self._consolidated["metadata"][ATTRIBUTES]
        attributes[SUMMARY] = text
        write_whole(self._root / ATTRIBUTES, json.dumps(attributes))
        self._commit(self.records)

    def _append_samples(self) -> None:
        if new := self._samples:
            columns = {name: [sample[name] for sample in new] for name in new[0]}
            self._put(columns, self.samples, len(new))
            self.samples += len(new)
            self._samples = []

    def _put(self, values: Mapping[str, ArrayLike], begin: int, count: int) -> None:
        """Write count numbers or rows of each variable, the first one at index begin.

        The metadata of the arrays come from the consolidated ones.  Whatever an earlier, failed
        write did to the length of an array, `resize` replaces.  Raises ValueError for values that
        do not fit.
        """
        import zarr

        group = zarr.open_group(self._root, mode="r+", zarr_format=2, use_consolidated=True)
        for name, value in values.items():
            array: Any = group[name]
            numbers = np.reshape(value, (count, *array.shape[1:]))
            array.resize((begin + count, *array.shape[1:]))
            array[begin:] = numbers
            size, rest = array.chunks[0], ".0" * (array.ndim - 1)
            chunks = range(begin // size, (begin + count - 1) // size + 1)
            self._unsynced |= {name, *(f"{name}/{k}{rest}" for k in chunks)}

    def _commit(self, records: int) -> None:
        """Publish the lengths, after all numbers are on the disk."""
        for name in sorted(self._unsynced):
            with suppress(FileNotFoundError):  # Zarr omits chunks that hold the fill value alone
                sync(self._root / name)
        self._unsynced.clear()
        lengths = {"time": records, SERIES: self.samples}
        for name, axes in self._axes.items():
            if axes and axes[0] in lengths:
                shape = self._consolidated["metadata"][f"{name}/.zarray"]["shape"]
                shape[0] = lengths[axes[0]]
        write_whole(self._root / CONSOLIDATED, json.dumps(self._consolidated))

    @property
    def _root(self) -> Path:
        return self._place if self._in_place else part_of(self._place)
