"""Headers of netCDF classic files, with the offsets of what they describe.

Format: "NetCDF Classic and 64-bit Offset File Formats", NASA ESDS-RFC-011v2.0, with offsets of
64 bits.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from swe_sphere.io.layout import SERIES, Layout

MAGIC = b"CDF\x02"
RECORDS_AT = len(MAGIC)
"""Offset of the number of records [bytes]."""
DIMENSIONS, VARIABLES, ATTRIBUTES = 10, 11, 12
"""Tags of the lists."""
TEXT = 2
TYPES = {"i": (4, ">i4"), "f": (6, ">f8")}
"""Number of each type, and of numbers how they are stored, by their kind in numpy."""


class Header:
    """Header of a file without records; all offsets and sizes are in bytes."""

    def __init__(self, layout: Layout) -> None:
        self.data = bytearray(MAGIC + bytes(4))
        self._add(DIMENSIONS, len(layout.sizes))
        for name, size in layout.sizes.items():
            self._add_text(name)
            self._add(size)
            if name == SERIES:
                self.samples_at = len(self.data) - 4
                """Offset of the length of the series."""
        self.texts = self._add_attributes(layout.attributes)
        """Offset and size of the value of each global attribute that is a text."""
        self.recorded: dict[str, int] = {}
        """Size of a record of each variable that has records."""
        self._add_variables(layout)

    def _add_variables(self, layout: Layout) -> None:
        axes, sizes, places = [*layout.sizes], {}, {}
        self._add(VARIABLES, len(layout.variables))
        for name, variable in layout.variables.items():
            lengths = [layout.sizes[axis] for axis in variable.axes]
            kind, stored = TYPES["f" if variable.values is None else variable.values.dtype.kind]
            has_records = lengths[:1] == [0]
            sizes[name] = np.dtype(stored).itemsize * math.prod(lengths[has_records:])
            if has_records:
                self.recorded[name] = sizes[name]
            self._add_text(name)
            self._add(len(lengths), *map(axes.index, variable.axes))
            self._add_attributes(variable.attributes)
            self._add(kind, min(sizes[name], 2**32 - 1), 0, 0)
            places[name] = len(self.data) - 8
        end, self.begins = len(self.data), {}
        """Offset of each variable; of one with records, in the first of them."""
        for name in sorted(sizes, key=self.recorded.__contains__):  # records follow all others
            self.begins[name] = end
            self.data[places[name] : places[name] + 8] = end.to_bytes(8, "big")
            end += sizes[name]
        self.record_bytes = sum(self.recorded.values())
        self.end = end - self.record_bytes
        """Offset of the first record."""

    def _add(self, *numbers: int) -> None:
        self.data += np.array(numbers, ">u4").tobytes()

    def _add_text(self, text: str) -> None:
        data = text.encode()
        self._add(len(data))
        self.data += data + bytes(-len(data) % 4)

    def _add_attributes(self, values: Mapping[str, Any]) -> dict[str, tuple[int, int]]:
        places = {}
        self._add(ATTRIBUTES if values else 0, len(values))
        for name, value in values.items():
            self._add_text(name)
            if isinstance(value, str):
                self._add(TEXT)
                places[name] = len(self.data) + 4, len(value)
                self._add_text(value)
            else:
                numbers = np.asarray(value)
                self._add(TYPES[numbers.dtype.kind][0], numbers.size)
                self.data += as_bytes(numbers)
        return places


def as_bytes(numbers: ArrayLike) -> memoryview:
    """Return the bytes of numbers in a file."""
    array = np.asarray(numbers)
    stored = np.ascontiguousarray(array, TYPES[array.dtype.kind][1])
    return stored.reshape(-1).view(np.uint8).data
