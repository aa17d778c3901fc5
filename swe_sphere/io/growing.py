"""Files of runs that grow in place and are whole at every moment, whatever ends the process.

A netCDF classic file counts its records, and says how long each dimension is, in numbers of four
bytes in its header.  So what is new is first written where nobody looks yet, and then counted by
one write of four bytes: a process killed before that has added nothing, one killed after it all.
Records (frames) follow each other at the end of the file.  A second dimension, that of the series,
grows in the same way into the room that its variables had when the file was made.
"""

import io
import os
import struct
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

import netCDF4
import numpy as np
from numpy.typing import ArrayLike

from swe_sphere.errors import RunFailed
from swe_sphere.files.durable import allocate, claim, part_of, put_in_place, remove
from swe_sphere.io.classic import FORMAT, RECORDS_AT, read_header

_COUNT = struct.Struct(">I")


class Growing:
    """A file or folder that grows, built at `part_of(place)` until it is put in place.

    series: the dimension of the series.  folder: whether it is a folder.  Raises ConfigError if
    another program writes it.
    """

    def __init__(self, place: Path, series: str, folder: bool = False) -> None:
        self._place, self._series = place, series
        self._descriptor = claim(place, folder)
        self._open, self._in_place = True, False
        self.records = self.samples = 0
        """How many there are."""
        self.recorded: frozenset[str] = frozenset()
        """Names of the variables that have records."""

    def put_in_place(self) -> None:
        """It takes its name, unless it has it already."""
        if not self._in_place:
            put_in_place(self._descriptor, self._place)
            self._in_place = True

    def check(self, path: Path) -> None:
        """RunFailed if another program has removed, replaced or cut short what is in place."""
        if not self._in_place:
            return
        try:
            found = path.stat()
        except FileNotFoundError:
            raise RunFailed(f"{path} was deleted while the run was writing it") from None
        if not os.path.samestat(found, os.fstat(self._descriptor)):
            raise RunFailed(f"{path} was replaced while the run was writing it")

    def close(self) -> None:
        """May be called again; what is not in place is removed."""
        if self._open:
            if not self._in_place:
                remove(part_of(self._place))
            os.close(self._descriptor)
        self._open = False


class GrowingFile(Growing):
    """A netCDF classic file, whose variables that grow are of float64.

    size: bytes that the file must be able to have.  The methods raise OSError as the system does.
    """

    def __init__(self, place: Path, series: str, size: int) -> None:
        super().__init__(place, series)
        self._file = io.FileIO(self._descriptor, "r+", closefd=False)
        try:
            allocate(self._descriptor, place, size)
        except OSError:
            self.close()
            raise

    def define(self, define: Callable[[netCDF4.Dataset], None]) -> None:
        """Write everything that does not grow: what `define` makes in a dataset.

        The length of the dimension of the series is the number of samples for which there is room.
        """
        with netCDF4.Dataset(part_of(self._place), "w", format=FORMAT) as dataset:
            dataset.set_fill_off()
            define(dataset)
        self._header = read_header(self._file)
        self.recorded = frozenset(self._header.recorded)
        self._length_at = self._header.lengths.get(self._series)
        self._room = 0 if self._length_at is None else self._number(self._length_at)

    def add_record(self, values: Mapping[str, ArrayLike], sync: bool = True) -> None:
        """Add a record, given every variable that has records, and put it on the disk.

        sync: wait until the disk has it, which a file that is not in its place yet does not need.
        Raises ValueError for values of other lengths than those of the records.
        """
        if {name: 8 * np.size(value) for name, value in values.items()} != self._header.recorded:
            raise ValueError(f"the values do not fit the records of {self._place}")
        done = self.records * self._header.record_bytes
        try:
            for name, value in values.items():
                self._write(self._header.begins[name] + done, _stored(value))
            if sync:
                self.sync()
        except OSError:
            with suppress(OSError):  # makes room for what is to be said of the failure
                self._file.truncate(self._end)
            raise
        self._write(RECORDS_AT, _COUNT.pack(self.records + 1))
        self.records += 1

    def add_sample(self, values: Mapping[str, float]) -> None:
        """Add a number to each series; ValueError if their room is used up."""
        if self._length_at is None or self.samples == self._room:
            raise ValueError(f"there is room for {self._room} samples only")
        for name, value in values.items():
            self._write(self._header.begins[name] + 8 * self.samples, _stored([value]))
        self._write(self._length_at, _COUNT.pack(self.samples + 1))
        self.samples += 1

    def set_text(self, name: str, text: str) -> None:
        """Replace a global attribute, which is at least as long, by a text, and sync."""
        place, size = self._header.texts[name]
        data = text.encode("ascii")
        if len(data) > size:
            raise ValueError(f"{name} has room for {size} characters, not for {len(data)}")
        self._write(place, data.ljust(size, b"\0"))
        self.sync()

    def sync(self) -> None:
        """All that was written is on the disk, if the system keeps its word."""
        os.fsync(self._file.fileno())

    def check(self, path: Path) -> None:
        """As `Growing.check`, also for a file that is cut short or changed."""
        super().check(path)
        size = os.fstat(self._descriptor).st_size
        if self._in_place and (size < self._end or self._number(RECORDS_AT) != self.records):
            raise RunFailed(f"{path} was cut short or changed while the run was writing it")

    @property
    def _end(self) -> int:
        """Where the last record ends."""
        return self._header.end + self.records * self._header.record_bytes

    def _number(self, place: int) -> int:
        self._file.seek(place)
        return int.from_bytes(self._file.read(4), "big")

    def _write(self, place: int, data: bytes | memoryview) -> None:
        self._file.seek(place)
        rest = memoryview(data)
        while rest:
            rest = rest[self._file.write(rest) :]


def _stored(values: ArrayLike) -> memoryview:
    """Numbers as the bytes that stand in the file."""
    return np.ascontiguousarray(values, ">f8").reshape(-1).view(np.uint8).data
