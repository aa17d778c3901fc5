"""Checkpoints in an output file: two slots written in turn, so that one is always whole.

Group "restart" / "layout<k>" / "slot0" and "slot1"; a new layout begins where the arrays of the
stepper change in name, type or size.  In a slot every array is a variable of fixed size, rewritten
in place, and so are the header's numbers: a kill in the middle spoils that slot's check sum and
nothing else, and the reader falls back on the other.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

from swe_sphere.errors import ConfigError
from swe_sphere.output.runfile import attributes, reading

__all__ = ["Checkpoint", "Slots", "read_checkpoint"]

Memory = Mapping[str, NDArray[np.generic]]

NATIVE = ("<f8", "<f4", "<i8", "<i4")
HEADER = {"sequence": "i8", "steps": "i8", "time": "f8", "checksum": "u8"}


@dataclass(frozen=True)
class Checkpoint:
    """The memory of a stepper, where it stood, and the attributes of the file it came from."""

    memory: dict[str, NDArray[np.generic]]
    time: float
    """[s] since the start."""
    steps: int
    stepper: str
    attributes: dict[str, object]


class Slots:
    """Writes checkpoints into the two slots of an open file in turn."""

    def __init__(self, dataset: netCDF4.Dataset) -> None:
        self._dataset = dataset
        self._signature: object = None
        self._slots: list[netCDF4.Group] = []
        self._layouts = 0
        self._sequence = 0

    def room(self, memory: Memory, stepper: str) -> int:
        """Bytes that the next checkpoint may add to the file: none where the slots fit it."""
        if self._signature == _signature(memory, stepper):
            return 0
        return 2 * sum(array.nbytes for array in memory.values()) + 4096 * 2 * (len(memory) + 4)

    def write(self, memory: Memory, time: float, steps: int, stepper: str) -> None:
        """Overwrite the older slot (both are made at the first checkpoint of a layout)."""
        if self._signature != _signature(memory, stepper):
            self._add_layout(memory, stepper)
        self._sequence += 1
        slot = self._slots[self._sequence % 2]
        for name, array in memory.items():
            slot["memory"][name][:] = _storable(array)
        numbers = {"sequence": self._sequence, "steps": steps, "time": time}
        for name, number in numbers.items():
            slot[name][...] = number
        slot["checksum"][...] = _checksum(numbers, stepper, memory)

    def _add_layout(self, memory: Memory, stepper: str) -> None:
        parent = self._dataset.createGroup(f"restart/layout{self._layouts}")
        parent.stepper = stepper
        self._layouts += 1
        self._slots = [_add_slot(parent.createGroup(f"slot{k}"), memory) for k in range(2)]
        self._signature = _signature(memory, stepper)


def _signature(memory: Memory, stepper: str) -> object:
    """What two checkpoints have in common that fit the same slots."""
    return stepper, [(name, a.dtype.str, a.shape) for name, a in memory.items()]


def _add_slot(slot: netCDF4.Group, memory: Memory) -> netCDF4.Group:
    for name, kind in HEADER.items():
        slot.createVariable(name, kind)[...] = 0
    group = slot.createGroup("memory")
    for name, array in memory.items():
        stored = _storable(array)
        group.createDimension(name, stored.size)
        variable = group.createVariable(name, stored.dtype, (name,), contiguous=True)
        variable.setncatts({"array_type": array.dtype.str, "array_shape": json.dumps(array.shape)})
        variable[:] = stored  # takes the room on disk now
    return slot


def _storable(array: NDArray[np.generic]) -> NDArray[Any]:
    """The array's numbers in a row of a type that netCDF has; one byte where there are none."""
    flat = np.ascontiguousarray(array).reshape(-1)
    if flat.size == 0:
        return np.zeros(1, dtype=np.uint8)
    return flat if flat.dtype.str in NATIVE else flat.view(np.uint8)


def _restored(variable: netCDF4.Variable[Any]) -> NDArray[np.generic]:
    """The array that `_storable` was given."""
    shape = json.loads(variable.array_shape)
    kind = np.dtype(variable.array_type)
    size = math.prod(shape) * kind.itemsize
    return np.frombuffer(variable[:].tobytes()[:size], dtype=kind).reshape(shape).copy()


def _checksum(numbers: Mapping[str, float], stepper: str, memory: Memory) -> int:
    digest = hashlib.blake2b(digest_size=8)
    digest.update(f"{stepper} {numbers['sequence']:d} {numbers['steps']:d}".encode())
    digest.update(np.float64(numbers["time"]).tobytes())
    for name, array in sorted(memory.items()):
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array).data)
    return int.from_bytes(digest.digest(), "little")


def read_checkpoint(path: str | os.PathLike[str]) -> Checkpoint:
    """The latest whole checkpoint in a file.

    Raises ConfigError, in one line, if the file is missing, damaged or truncated, or holds no
    whole checkpoint.
    """
    with reading(path) as dataset:
        slots = [*_slots(dataset)]
        whole = [found for slot in slots if (found := _read_slot(*slot)) is not None]
        configuration = attributes(dataset)
    if not slots:
        raise ConfigError(f"{path} holds no checkpoint: run with checkpoints to restart from it")
    if not whole:
        raise ConfigError(f"the checkpoint in {path} is damaged: start again, or from another file")
    _, (memory, time, steps, stepper) = max(whole, key=lambda found: found[0])
    return Checkpoint(memory, time, steps, stepper, configuration)


def _slots(dataset: netCDF4.Dataset) -> Iterator[tuple[str, netCDF4.Group]]:
    """Every slot with the name of its stepper."""
    restart = dataset.groups.get("restart")
    for layout in restart.groups.values() if restart else ():
        yield from ((layout.stepper, slot) for slot in layout.groups.values())


def _read_slot(
    stepper: str, slot: netCDF4.Group
) -> tuple[int, tuple[dict[str, NDArray[np.generic]], float, int, str]] | None:
    """Sequence number and contents of a slot; None if it was not written or not to the end."""
    try:
        numbers = {name: slot[name][...].item() for name in HEADER}
        memory = {name: _restored(array) for name, array in slot["memory"].variables.items()}
    except (OSError, RuntimeError, LookupError, AttributeError, ValueError, TypeError):
        return None
    if numbers["checksum"] != _checksum(numbers, stepper, memory):
        return None
    return numbers["sequence"], (memory, numbers["time"], numbers["steps"], stepper)
