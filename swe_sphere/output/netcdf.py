"""Streaming a run to netCDF: CF-1.11, and the nodes and sub-quads of the mesh as UGRID."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Self

import netCDF4
import numpy as np
from numpy.typing import ArrayLike

from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.mesh import Mesh
from swe_sphere.output.checkpoint import Slots, read_checkpoint
from swe_sphere.output.disk import Room, allocate, clear_errors, in_use
from swe_sphere.output.layout import (
    LAYOUT_BYTES,
    SERIES_CHUNK,
    add_diagnostic,
    add_layout,
    attribute,
    frame_fields,
)

__all__ = ["FrameWriter", "read_checkpoint"]

MARGIN = 256 * 1024
"""Room [bytes] for the indices and headers that a flush may add."""
CHUNK = 8 * 1024
"""Room [bytes] for the next chunk of one series of numbers."""
MENDING = "; free some space or write elsewhere (all that was written before can still be read)"


class FrameWriter:
    """Writes frames, series of diagnostics and checkpoints to one file, flushed frame by frame.

    path: the file, replaced if it is there.  attributes: the resolved configuration, written as
    global attributes (nested tables as JSON); the parameters of the mesh are added.  bottom
    (N,) [m]: height of the orography, zero where None.  tracers: their names.

    Raises ConfigError if the file cannot be made or there is no room for a first frame.  Every
    method raises RunFailed if the disk is full or refuses; what was written before stays readable.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        mesh: Mesh,
        attributes: Mapping[str, object],
        bottom: ArrayLike | None = None,
        tracers: Iterable[str] = (),
    ) -> None:
        self._fields = frame_fields(tracers)
        self.path = Path(path)
        self.frames = 0
        """Frames written so far."""
        self._records = 0
        self._frame_bytes = (len(self._fields) + 1) * 8 * mesh.size
        self._static_bytes = LAYOUT_BYTES * mesh.size + MARGIN
        self._series: dict[str, netCDF4.Variable[np.float64]] = {}
        with clear_errors(f"cannot write {self.path}"):
            self._dataset = self._create()
            self._room = Room(self.path)
            self._put_attributes(attributes)
            add_layout(self._dataset, mesh, bottom, self._fields)
            self._dataset.sync()
        self._slots = Slots(self._dataset)

    def _create(self) -> netCDF4.Dataset:
        """The new file; opened by hand first, as netCDF calls every failure "permission denied"."""
        existed = self.path.exists()
        file = os.open(self.path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            if in_use(file, for_writing=True):
                raise ConfigError(f"cannot write {self.path}: another program has it open")
            allocate(file, self.path, 0, self._static_bytes + self._frame_bytes)
        except OSError:
            if not existed:
                self.path.unlink()
            raise
        finally:
            os.close(file)
        return netCDF4.Dataset(self.path, "w", format="NETCDF4")

    def write(
        self,
        time: float,
        fields: Mapping[str, ArrayLike],
        diagnostics: Mapping[str, float | None] | None = None,
    ) -> None:
        """Add a frame at time [s since the start] and flush the file.

        fields: h [m], u, v [m s-1], vorticity, divergence [s-1] and q_NAME of each tracer, all of
        them (N,); others are ignored.
        diagnostics: as for `record`, at the same time.
        """
        with self._writing(self._frame_bytes + MARGIN + self._series_room(diagnostics or {})):
            for name in self._fields:
                self._dataset[name][self.frames] = fields[name]
            self._dataset["time"][self.frames] = time
            if diagnostics:
                self._record(time, diagnostics)
            self._flush()
            self.frames += 1

    def record(self, time: float, diagnostics: Mapping[str, float | None]) -> None:
        """Add numbers at time [s] to the series along `diagnostic_time`; flushed with the frames.

        A name that is new starts a series (missing before); None and absent names are missing.
        """
        with self._writing(self._series_room(diagnostics)):
            self._record(time, diagnostics)

    def checkpoint(
        self, memory: Mapping[str, np.ndarray], time: float, steps: int, stepper: str
    ) -> None:
        """Store what a bitwise exact restart needs, beside the checkpoint before, and flush.

        memory: the stepper's arrays; time [s], steps: where it stands; stepper: its name.
        """
        arrays = {name: np.asarray(array) for name, array in memory.items()}
        with self._writing(self._slots.room(arrays, stepper) + MARGIN):
            self._slots.write(arrays, time, steps, stepper)
            self._flush()

    def set_attributes(self, attributes: Mapping[str, object]) -> None:
        """Add or replace global attributes (counters, how the run ended) and flush."""
        with self._writing(MARGIN):
            self._put_attributes(attributes)
            self._flush()

    def close(self) -> None:
        """Close the file; may be called again, and after a failure."""
        if not self._dataset.isopen():
            return
        try:
            with clear_errors(f"cannot finish {self.path}", RunFailed, MENDING):
                self._dataset.close()
                self._room.trim()
        finally:
            self._room.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        with suppress(*([RunFailed] if error else [])):  # the first failure is the one to report
            self.close()

    @contextmanager
    def _writing(self, room: int) -> Iterator[None]:
        """Take room for so many bytes; RunFailed for what the disk says then or in the block."""
        with clear_errors(f"cannot write {self.path}", RunFailed, MENDING):
            self._room.reserve(room)
            yield

    def _flush(self) -> None:
        self._dataset.sync()
        self._room.settle()

    def _series_room(self, diagnostics: Mapping[str, object]) -> int:
        """Bytes the next record may add: nothing, but for the first of a chunk or of a series."""
        new = self._records % SERIES_CHUNK == 0 or not diagnostics.keys() <= self._series.keys()
        return CHUNK * (len(diagnostics) + 1) if new else 0

    def _record(self, time: float, diagnostics: Mapping[str, float | None]) -> None:
        self._dataset["diagnostic_time"][self._records] = time
        for name, value in diagnostics.items():
            if name not in self._series:
                self._series[name] = add_diagnostic(self._dataset, name)
            if value is not None:
                self._series[name][self._records] = value
        self._records += 1

    def _put_attributes(self, attributes: Mapping[str, object]) -> None:
        self._dataset.setncatts({name: attribute(value) for name, value in attributes.items()})
