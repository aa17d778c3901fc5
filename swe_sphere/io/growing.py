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
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from swe_sphere.errors import RunFailed
from swe_sphere.io.classic import RECORDS_AT, read_header

_COUNT = struct.Struct(">I")


class GrowingFile:
    """A file that the netCDF library has made, without a record, with room in its series.

    file: open for reading and writing.  series: the dimension of the series; as long as it is
    when the file is made, as many samples there is room for.  All variables that grow are of
    float64.  The methods raise OSError as the system does.
    """

    def __init__(self, file: io.FileIO, series: str) -> None:
        self._file, self._header = file, read_header(file)
        self._length_at = self._header.lengths.get(series)
        self._room = 0 if self._length_at is None else self._number(self._length_at)
        self.recorded = self._header.recorded
        """Names of the variables that have records."""
        self.records = self.samples = 0
        """How many there are."""

    def add_record(self, values: Mapping[str, ArrayLike], sync: bool = True) -> None:
        """Add a record, given every variable that has records, and put it on the disk.

        sync: wait until it is there, which a file that nobody looks at yet need not.
        """
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
        """Put a text in the place of a global attribute that is at least as long, and sync."""
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
        """RunFailed if another program has removed, replaced or cut short the file there."""
        try:
            found = path.stat()
        except FileNotFoundError:
            raise RunFailed(f"{path} was deleted while the run was writing it") from None
        ours = os.fstat(self._file.fileno())
        if not os.path.samestat(found, ours):
            raise RunFailed(f"{path} was replaced while the run was writing it")
        if ours.st_size < self._end or self._number(RECORDS_AT) != self.records:
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
