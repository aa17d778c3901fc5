"""The header of a netCDF classic file: where its variables begin and where it counts them.

Format: "NetCDF Classic and 64-bit Offset File Formats", NASA ESDS-RFC-011v2.0, with offsets of
64 bits.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

FORMAT: Final = "NETCDF3_64BIT_OFFSET"
"""What the netCDF library calls the format."""

MAGIC = b"CDF\x02"
RECORDS_AT = len(MAGIC)
"""Where the number of records stands [bytes]."""
SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 4, 6: 8}
"""Bytes of a value of each type."""


@dataclass(frozen=True)
class Header:
    """Where things stand in a file [bytes from its start]."""

    records: int
    """How many records there are."""
    record_bytes: int
    """Bytes from one record to the next."""
    lengths: dict[str, int]
    """Where the length of each dimension stands, a number of four bytes."""
    texts: dict[str, tuple[int, int]]
    """Where the value of each global attribute stands, and its bytes."""
    begins: dict[str, int]
    """Where each variable begins; one with records, in the first of them."""
    recorded: dict[str, int]
    """Which variables have records, and the bytes of one."""
    end: int
    """Where the last variable ends."""


class _Scanner:
    """Takes a header apart from front to back."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    @property
    def position(self) -> int:
        return self._file.tell()

    def take(self, size: int) -> bytes:
        found = self._file.read(size)
        if len(found) != size:
            raise ValueError("it ends within its header")
        return found

    def number(self, size: int = 4) -> int:
        return int.from_bytes(self.take(size), "big")

    def text(self) -> str:
        size = self.number()
        return self.take(size + -size % 4)[:size].decode()

    def items(self) -> range:
        """For every item of the list that follows."""
        self.number()  # says what kind of list it is
        return range(self.number())

    def attributes(self) -> dict[str, tuple[int, int]]:
        found = {}
        for _ in self.items():
            name, size = self.text(), SIZES[self.number()] * self.number()
            found[name] = (self.position, size)
            self.take(size + -size % 4)
        return found


def read_header(file: BinaryIO) -> Header:
    """The header of an open file; ValueError or LookupError if it is damaged or none."""
    file.seek(0)
    scanner = _Scanner(file)
    if scanner.take(len(MAGIC)) != MAGIC:
        raise ValueError("not a netCDF classic file with 64-bit offsets")
    records, lengths, sizes = scanner.number(), {}, []
    for _ in scanner.items():
        name = scanner.text()
        lengths[name] = scanner.position
        sizes.append(scanner.number())
    texts = scanner.attributes()
    begins, bytes_of, counted = {}, {}, {}
    for _ in scanner.items():
        name, shape = scanner.text(), [scanner.number() for _ in range(scanner.number())]
        scanner.attributes()
        scanner.number()  # its type
        bytes_of[name], begins[name] = scanner.number(), scanner.number(8)
        if shape and sizes[shape[0]] == 0:
            counted[name] = bytes_of[name]
    record_bytes = sum(counted.values())
    before = {name: (records - 1) * record_bytes if name in counted else 0 for name in begins}
    ends = [begins[name] + before[name] + bytes_of[name] for name in begins]
    end = max(ends, default=0)
    return Header(records, record_bytes, lengths, texts, begins, counted, end)


def check_length(path: Path) -> None:
    """ValueError if a classic file ends before its data do, of which netCDF says nothing."""
    with path.open("rb") as file:
        if file.read(len(MAGIC)) == MAGIC and read_header(file).end > path.stat().st_size:
            raise ValueError("it ends within its data")
