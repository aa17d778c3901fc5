"""Files of runs that grow in place and are whole at every moment, whatever ends the process.

A netCDF classic file counts its records and states the length of each dimension in numbers of four
bytes in its header.  New numbers are first written beyond these lengths and then counted by one
write of four bytes: a process killed before that has added nothing, one killed after it all.
Records (frames) follow each other at the end of the file.  A second dimension, that of the series,
grows in the same way into the room that its variables had when the file was made.

Format: "NetCDF Classic and 64-bit Offset File Formats", NASA ESDS-RFC-011v2.0, with offsets of
64 bits.
"""

import math
import mmap
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from swe_sphere.errors import RunFailed
from swe_sphere.files.durable import allocate, claim, part_of, remove, take_place
from swe_sphere.io.layout import SERIES, SUMMARY_BYTES

RECORDS_AT = 4
"""Offset of the number of records [bytes]."""


class Growing:
    """A file or folder that grows, built at `part_of(place)` until it is put in place.

    folder: whether it is a folder.  Raises ConfigError if another program writes it.
    """

    def __init__(self, place: Path, folder: bool = False) -> None:
        self._place = place
        self._descriptor = claim(place, folder)
        self._open, self._in_place = True, False
        self.records = self.samples = 0
        """Numbers of records (frames) and of samples in each series."""

    def put_in_place(self) -> None:
        """Give the file its name, unless it has it already."""
        if not self._in_place:
            take_place(self._place)
            self._in_place = True

    def check(self, path: Path) -> None:
        """Raise RunFailed if another program has removed, replaced or cut short the file."""
        if not self._in_place:
            return
        try:
            found = path.stat()
        except FileNotFoundError:
            raise RunFailed(f"{path} was deleted while the run was writing it") from None
        if not os.path.samestat(found, os.fstat(self._descriptor)):
            raise RunFailed(f"{path} was replaced while the run was writing it")

    def close(self) -> None:
        """Close the file, which may be done again; a file that is not in place is removed."""
        if self._open:
            if not self._in_place:
                remove(part_of(self._place))
            os.close(self._descriptor)
        self._open = False


class GrowingFile(Growing):
    """A netCDF classic file.

    size: bytes that the file must be able to have.  The methods raise OSError as the system does.
    """

    def __init__(self, place: Path, size: int) -> None:
        super().__init__(place)
        try:
            allocate(self._descriptor, place, size)
        except OSError:
            self.close()
            raise

    def define(self, data: xr.Dataset) -> None:
        """Write everything that does not grow.

        data: without frames; the series are its last variables, full of missing samples.
        """
        variables = data.variables.items()
        data.to_netcdf(
            part_of(self._place), format="NETCDF3_64BIT", engine="netcdf4", unlimited_dims=["time"],
            encoding={n: {"_FillValue": None} for n, v in variables if "_FillValue" not in v.attrs},
        )  # fmt: skip
        self._lengths = {name: math.prod(v.shape[1:]) for name, v in variables if "time" in v.dims}
        self._series = [name for name, v in variables if v.dims == (SERIES,)]
        self._room = data.sizes.get(SERIES, 0)
        self._first = os.fstat(self._descriptor).st_size  # offset of the first record
        with mmap.mmap(self._descriptor, 0, access=mmap.ACCESS_READ) as header:
            # dimensions come first: a name, padded to whole words of four bytes, and a length
            self._samples_at = header.find(SERIES.encode()) + 4 * math.ceil(len(SERIES) / 4)
            self._summary_at = header.find(b" " * SUMMARY_BYTES)

    @property
    def _end(self) -> int:
        """Offset of the next record."""
        return self._first + 8 * self.records * sum(self._lengths.values())

    def add_record(self, values: Mapping[str, ArrayLike], sync: bool = True) -> None:
        """Add a record, given every variable that has records, and put it on the disk.

        sync: wait until the disk has it, which a file that is not in its place yet does not need.
        Raises ValueError for values of other lengths than those of the records.
        """
        if {name: np.size(value) for name, value in values.items()} != self._lengths:
            raise ValueError(f"the values do not fit the records of {self._place}")
        try:
            self._write(self._end, [np.ravel(values[str(name)]) for name in self._lengths])
            if sync:
                os.fsync(self._descriptor)
        except OSError:
            with suppress(OSError):  # makes room for the summary of the failure
                os.truncate(self._descriptor, self._end)
            raise
        self._count(RECORDS_AT, self.records + 1)
        self.records += 1

    def add_sample(self, values: Mapping[str, float]) -> None:
        """Add a number to each series; ValueError if their room is used up."""
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
        """As `Growing`, also for a file that is cut short or changed."""
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
