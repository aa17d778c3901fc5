"""Files of runs that grow in place and are whole at every moment, whatever ends the process.

A netCDF classic file counts its records and states the length of each dimension in numbers of four
bytes in its header.  New numbers are first written beyond these lengths and then counted by one
write of four bytes: a process killed before that has added nothing, one killed after it all.
Records (frames) follow each other at the end of the file.  A second dimension, that of the series,
grows in the same way into the room that its variables had when the file was made.
"""

import io
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from swe_sphere.errors import RunFailed
from swe_sphere.files.durable import allocate, claim, part_of, put_in_place, remove
from swe_sphere.io.classic import RECORDS_AT, Header, as_bytes
from swe_sphere.io.layout import SERIES, Layout


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
            put_in_place(self._descriptor, self._place)
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
        self._file = io.FileIO(self._descriptor, "r+", closefd=False)
        try:
            allocate(self._descriptor, place, size)
        except OSError:
            self.close()
            raise

    def define(self, layout: Layout) -> None:
        """Write everything that does not grow.

        The length of the dimension of the series is the number of samples for which there is room.
        """
        self._header, self._room = Header(layout), layout.sizes.get(SERIES, 0)
        self._file.truncate(0)
        self._write(0, self._header.data)
        for name, variable in layout.variables.items():
            if variable.values is not None:
                self._write(self._header.begins[name], as_bytes(variable.values))

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
                self._write(self._header.begins[name] + done, as_bytes(np.asarray(value, float)))
            if sync:
                os.fsync(self._descriptor)
        except OSError:
            with suppress(OSError):  # makes room for the summary of the failure
                self._file.truncate(self._header.end + done)
            raise
        self._write(RECORDS_AT, _count(self.records + 1))
        self.records += 1

    def add_sample(self, values: Mapping[str, float]) -> None:
        """Add a number to each series; ValueError if their room is used up."""
        if self.samples == self._room:
            raise ValueError(f"there is room for {self._room} samples only")
        for name, value in values.items():
            number = as_bytes(np.asarray(value, float))
            self._write(self._header.begins[name] + 8 * self.samples, number)
        self._write(self._header.samples_at, _count(self.samples + 1))
        self.samples += 1

    def set_text(self, name: str, text: str) -> None:
        """Replace a global attribute, which is at least as long, by an ASCII text, and sync."""
        place, size = self._header.texts[name]
        self._write(place, text.encode("ascii").ljust(size, b"\0"))
        os.fsync(self._descriptor)

    def check(self, path: Path) -> None:
        """As `Growing`, also for a file that is cut short or changed."""
        super().check(path)
        size = os.fstat(self._descriptor).st_size
        self._file.seek(RECORDS_AT)
        counted = self._file.read(4) == _count(self.records)
        if self._in_place:
            end = self._header.end + self.records * self._header.record_bytes
            if size < end or not counted:
                raise RunFailed(f"{path} was cut short or changed while the run was writing it")

    def _write(self, place: int, data: bytes | bytearray | memoryview) -> None:
        self._file.seek(place)
        rest = memoryview(data)
        while rest:
            rest = rest[self._file.write(rest) :]


def _count(number: int) -> bytes:
    return number.to_bytes(4, "big")
