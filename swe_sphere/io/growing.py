"""Files of runs that grow in place and are complete at any time, however the process ends.

A netCDF classic file counts its records and states the length of each dimension in numbers of four
bytes in its header. New numbers are first written beyond these lengths and then counted by one
write of four bytes: a kill before this write adds nothing, and a kill after it adds everything.
Records (frames) follow each other at the end of the file. A second dimension, that of the series,
grows in the same way into the space that its variables received when the file was created.

Format: "NetCDF Classic and 64-bit Offset File Formats", NASA ESDS-RFC-011v2.0, 64-bit offsets.

In Zarr stores (zarr-specs.readthedocs.io, version 2) each frame of each variable is one chunk. The
consolidated metadata, a single file that is replaced atomically, contain the length of every
variable. They are written last, so that a reader finds a frame of all variables or of none. The
lengths in the metadata of single arrays may be ahead after a failed write, and are not read.
"""

import json
import math
import mmap
import os
import re
from collections.abc import Mapping
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.files.durable import allocate, claim, release, remove, sync, take_place, write_whole
from swe_sphere.io.layout import SERIES, SUMMARY, SUMMARY_BYTES

if TYPE_CHECKING:
    import xarray as xr

RECORDS_AT = 4
"""Offset of the number of records [bytes]."""
MARK = b"\x12@\xfe\x01rec\x02"
"""A number that is written to the first record, to find the offset of the records."""

SUFFIX = ".zarr"
"""Ending of the names of stores."""
CONSOLIDATED, ATTRIBUTES = ".zmetadata", ".zattrs"
IN_STORES = r"[\d.]+|\.z(metadata|attrs|group|array)|zarr\.json|.*\.part(ial)?"
"""Names of the files of stores, with those that killed programs leave."""


def is_store(path: Path) -> bool:
    """Return whether a folder holds a Zarr store."""
    return any((path / name).is_file() for name in (CONSOLIDATED, ".zgroup", "zarr.json"))


def check_free(path: Path, overwrite: bool) -> None:
    """Raise the errors of `check_place`, and ConfigError if a file must not be replaced."""
    if os.path.lexists(path) and not overwrite:
        raise ConfigError(f"{path} exists: choose another name, or replace it with --overwrite")
    with suppress(OSError):  # of names that cannot be: writing fails
        check_place(path)


def check_place(path: Path, what: str = "") -> None:
    """Raise ConfigError, which begins with `what`, for a foreign folder or a place in a store."""
    for folder in filter(is_store, path.absolute().parents):
        raise ConfigError(f"{what}{folder} is a Zarr store: choose a place outside of it")
    if not path.is_dir():
        return
    if path.suffix.lower() != SUFFIX or not is_store(path):
        raise ConfigError(f"{what}{path} is a folder: give the name of a file in it")
    names = (part.name for part in path.rglob("*") if part.is_file())
    if others := sorted(name for name in names if not re.fullmatch(IN_STORES, name)):
        raise ConfigError(f"{what}{path} contains {others[0]}, not its own: move it away")


def check_zarr(path: Path) -> None:
    """Raise ConfigError if the package that reads and writes stores is missing."""
    if find_spec("zarr") is None:
        raise ConfigError(f"{path} needs the package zarr: pip install zarr")


class GrowingOutput:
    """A file or folder that grows, built under a temporary name until it is put in place.

    place: its final path; folder: True for a folder. ConfigError if another program writes there.
    """

    def __init__(self, place: Path, folder: bool = False) -> None:
        self._place = place
        self._descriptor, self._part = claim(place, folder)
        self._open, self._in_place = True, False
        self.records = self.samples = 0
        """Numbers of records (frames) and of samples in each series."""

    def put_in_place(self) -> None:
        """Rename the file to its final name, unless that has been done."""
        if not self._in_place:
            take_place(self._part, self._place)
            self._in_place = True

    def check(self, path: Path) -> None:
        """Raise RunFailed if another program has removed or replaced the file."""
        if not self._in_place:
            return
        try:
            found = path.stat()
        except FileNotFoundError:
            raise RunFailed(f"{path} was deleted while the run was writing it") from None
        if not os.path.samestat(found, os.fstat(self._descriptor)):
            raise RunFailed(f"{path} was replaced while the run was writing it")

    def close(self) -> None:
        """Close the file, possibly again; a file that is not in place is removed."""
        was_open, self._open = self._open, False
        if was_open:
            release(self._descriptor)
            if not self._in_place:
                remove(self._part)


class GrowingFile(GrowingOutput):
    """A netCDF classic file that can grow to `size` bytes. The methods raise OSError."""

    def __init__(self, place: Path, size: int) -> None:
        super().__init__(place)
        try:
            allocate(self._descriptor, place, size)
        except OSError:
            self.close()
            raise

    def define(self, data: "xr.Dataset") -> None:
        """Write the whole constant part of the file.

        data: without frames; the series are its last variables, full of missing samples.
        """
        import netCDF4  # slow to import

        variables = data.variables.items()
        data.to_netcdf(
            self._part, format="NETCDF3_64BIT", engine="netcdf4", unlimited_dims=["time"],
            encoding={n: {"_FillValue": None} for n, v in variables if "_FillValue" not in v.attrs},
        )  # fmt: skip
        self._lengths = {name: math.prod(v.shape[1:]) for name, v in variables if "time" in v.dims}
        self._series = [name for name, v in variables if v.dims == (SERIES,)]
        self._room = data.sizes.get(SERIES, 0)
        with netCDF4.Dataset(self._part, "a") as file:
            file.set_fill_off()
            file["time"][0] = np.frombuffer(MARK, ">f8")
        with mmap.mmap(self._descriptor, 0, access=mmap.ACCESS_READ) as header:
            before = [*self._lengths.values()][: [*self._lengths].index("time")]
            self._first = header.find(MARK) - 8 * sum(before)  # offset of the first record
            # dimensions come first: length of the name, name in words of four bytes, size
            name = len(SERIES).to_bytes(4, "big") + SERIES.encode()
            self._samples_at = header.find(name) + 4 * math.ceil(len(name) / 4)
            self._summary_at = header.find(b" " * SUMMARY_BYTES)
        self._count(RECORDS_AT, 0)
        os.truncate(self._descriptor, self._first)

    @property
    def _end(self) -> int:
        return self._first + 8 * self.records * sum(self._lengths.values())

    def add_record(self, values: Mapping[str, ArrayLike], wait: bool = True) -> None:
        """Append a record, given every variable that has records, and sync it to the disk.

        wait: wait for the disk, which a file that is not in place yet does not need. Raises
        ValueError for values of other lengths than those of the records.
        """
        if {name: np.size(value) for name, value in values.items()} != self._lengths:
            raise ValueError(f"the values do not fit the records of {self._place}")
        try:
            self._write(self._end, [np.ravel(values[str(name)]) for name in self._lengths])
            if wait:
                os.fsync(self._descriptor)
        except OSError:
            with suppress(OSError):  # makes room for the summary of the failure
                os.truncate(self._descriptor, self._end)
            raise
        self._count(RECORDS_AT, self.records + 1)
        self.records += 1

    def add_sample(self, values: Mapping[str, float]) -> None:
        """Append a number to each series; raises ValueError if their space is used up."""
        if self.samples == self._room:
            raise ValueError(f"there is room for {self._room} samples only")
        begin = self._first - 8 * self._room * len(self._series) + 8 * self.samples
        for k, name in enumerate(self._series):
            self._write(begin + 8 * k * self._room, [values[str(name)]])
        self._count(self._samples_at, self.samples + 1)
        self.samples += 1

    def set_summary(self, text: str) -> None:
        """Replace the attribute with the summary by an ASCII text, and sync."""
        self._put(self._summary_at, text.encode("ascii").ljust(SUMMARY_BYTES, b"\0"))
        os.fsync(self._descriptor)

    def check(self, path: Path) -> None:
        """Raise RunFailed as in `GrowingOutput`, and if the file was truncated or changed."""
        super().check(path)
        if self._in_place and (
            os.fstat(self._descriptor).st_size < self._end
            or os.pread(self._descriptor, 4, RECORDS_AT) != self.records.to_bytes(4, "big")
        ):
            raise RunFailed(f"{path} was cut short or changed while the run was writing it")

    def _count(self, place: int, number: int) -> None:
        self._put(place, number.to_bytes(4, "big"))

    def _write(self, place: int, numbers: list[ArrayLike]) -> None:
        self._put(place, np.hstack(numbers).astype(">f8").tobytes())

    def _put(self, place: int, data: bytes) -> None:
        while data:
            written = os.pwrite(self._descriptor, data, place)
            data, place = data[written:], place + written


class GrowingStore(GrowingOutput):
    """A Zarr store with the methods of `GrowingFile`.

    Samples are stored with the next record or summary; their number is not limited. Data of a
    failed write are never counted, and the next write replaces them.
    """

    def __init__(self, place: Path) -> None:
        check_zarr(place)
        super().__init__(place, folder=True)
        self._samples: list[Mapping[str, float]] = []
        self._unsynced: set[str] = set()

    def define(self, data: "xr.Dataset") -> None:
        sizes = {**data.sizes, "time": 1}
        self._axes = {str(name): variable.dims for name, variable in data.variables.items()}
        data.isel({SERIES: slice(0)}, missing_dims="ignore").to_zarr(
            self._root, zarr_format=2, consolidated=True,
            encoding={n: {"chunks": [sizes[x] for x in axes]} for n, axes in self._axes.items()},
        )  # fmt: skip
        self._consolidated = json.loads((self._root / CONSOLIDATED).read_text())
        self._unsynced = {str(path.relative_to(self._root)) for path in self._root.rglob("*")}

    def add_record(self, values: Mapping[str, ArrayLike], wait: bool = True) -> None:
        """Append a record as `GrowingFile` does; before a sync, readers do not find the record."""
        if wait:
            self._append_samples()
        self._put(values, self.records, 1)
        if wait:
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
        """Write `count` numbers or rows of each variable, the first one at index `begin`.

        The metadata of the arrays come from the consolidated ones. `resize` overrides any length of
        an array that an earlier, failed write changed. Raises ValueError if values do not fit.
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
                self._consolidated["metadata"][f"{name}/.zarray"]["shape"][0] = lengths[axes[0]]
        write_whole(self._root / CONSOLIDATED, json.dumps(self._consolidated))

    @property
    def _root(self) -> Path:
        return self._place if self._in_place else self._part
