"""The journal of a sweep: a line of JSON for all that happened, on disk before more happens."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from swe_sphere.durable import append_line
from swe_sphere.errors import ConfigError
from swe_sphere.studies.sweep.form import Record, complaint

__all__ = ["RECORDS", "Journal", "read_journal"]

RECORDS = "records.jsonl"


class Journal:
    """An append-only file of records, which a kill at any moment leaves readable.

    A last line that was cut short is dropped.  Raises ConfigError where the file is damaged
    elsewhere or cannot be written to.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.records = read_journal(path)
        _drop_cut_line(path)

    def append(self, record: Mapping[str, object]) -> None:
        """Write a record through to the disk.

        Raises:
            RunFailed: the disk does not take it.
        """
        plain = _plain(record)
        append_line(self.path, json.dumps(plain, allow_nan=False).encode())
        self.records.append(plain)


def read_journal(path: Path) -> list[Record]:
    """All whole records of a journal, in order; none where there is no file.

    Raises:
        ConfigError: a line other than the last is damaged or no record, or the file cannot be read.
    """
    try:
        lines = path.read_bytes().split(b"\n")
    except FileNotFoundError:
        return []
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from None
    whole = lines[:-1]  # what stands behind the last line break was cut short
    return [_parsed(path, number, line) for number, line in enumerate(whole, 1)]


def _parsed(path: Path, number: int, line: bytes) -> Record:
    try:
        record = json.loads(line)
    except (ValueError, RecursionError):
        raise ConfigError(
            f"line {number} of {path} is damaged: delete that line, and its run is made again"
        ) from None
    wrong = complaint(record)
    if wrong:
        raise ConfigError(
            f"line {number} of {path} is no record of a sweep by this version ({wrong}): delete"
            " that line, and its run is made again, or choose another folder"
        )
    return dict(record)


def _drop_cut_line(path: Path) -> None:
    """Take away what a kill left behind the last line break, so that lines stay lines."""
    if not path.exists():
        return
    whole = path.read_bytes().rpartition(b"\n")
    if whole[2]:
        os.truncate(path, len(whole[0]) + len(whole[1]))


def _plain(value: Any) -> Any:
    """The value with everything that JSON lacks made null, and numpy's numbers made Python's."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
