"""Streaming of a run to netCDF or Zarr, also when it resumes: CF-1.11, the mesh as UGRID."""

import json
import math
import os
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError, RunFailed, unknown_name
from swe_sphere.files.durable import translate_errors
from swe_sphere.io import layout
from swe_sphere.io.checkpoint import Checkpoint, checkpoint_path, write_checkpoint
from swe_sphere.io.growing import SUFFIX, GrowingFile, GrowingStore
from swe_sphere.io.runfile import RunFile, read_values, reading
from swe_sphere.io.scalar_fields import FIELDS, POWER, derive
from swe_sphere.mesh import Mesh

if TYPE_CHECKING:
    import xarray as xr

ROOM_FOR_SAMPLES = 1000
"""Largest number of samples of a file, unless another is given."""
MENDING = "; free some space or write elsewhere (everything written before stays readable)"
KEPT = ("run_id", "start_step", "history")
"""Attributes that a resumed run keeps."""


class FrameWriter(AbstractContextManager["FrameWriter"]):
    """Writes frames and series of diagnostics to one file, and checkpoints to one beside it.

    path: replaces an existing file with its first frame, and is complete at any time from then on;
    a Zarr store if the name ends in .zarr. attributes: the resolved configuration (nested tables
    become JSON); the parameters of the mesh and a run_id are added. bottom [m], coriolis [s-1]:
    (N,) or a number. tracers: their names. samples: largest number of times with diagnostics.
    append_from: time [s] from which the run in the file is resumed, under its run_id: its frames
    and samples before that time are copied first, and it stays in place until the new file has as
    many frames or is finished. about: attributes (long_name, units) of custom diagnostics.
    user_fields: values, (N,) or profiles as data arrays, of those in frames; the others are series.
    only: names of the fields in frames; all if empty. transform: the file contains its result for
    the dataset of each frame, the wind always as both components, and no series.

    Raises ConfigError for an unknown field, if the file cannot be created, if another run writes
    it, or if the run in it cannot be resumed; RunFailed if the disk fails or has no space for a
    first frame. Every method raises RunFailed if the disk is full or fails, or if another program
    has removed or changed the file; earlier frames stay readable.
    """

    def __init__(
        self, path: str | os.PathLike[str], mesh: Mesh, attributes: Mapping[str, object],
        bottom: ArrayLike = 0.0, tracers: Iterable[str] = (), samples: int = ROOM_FOR_SAMPLES,
        append_from: float | None = None, about: Mapping[str, Mapping[str, str]] | None = None,
        user_fields: Mapping[str, Any] | None = None, coriolis: ArrayLike = 0.0,
        only: Iterable[str] = (), transform: Callable[["xr.Dataset"], "xr.Dataset"] | None = None,
    ) -> None:  # fmt: skip
        self.path, self._mesh, self._samples = Path(path), mesh, samples
        self._transform = transform
        self._bottom, self._coriolis, self._about = bottom, coriolis, about or {}
        self._earlier = None if append_from is None else RunFile(self.path)
        self._from = append_from or 0.0
        frames = np.zeros(0) if self._earlier is None else self._earlier.times
        self.kept_times = frames[frames < self._from]  # of frames of the earlier run [s]
        kept: dict[str, Any] = {}
        size = 0
        if self._earlier is not None:
            ours, theirs = mesh.size, self._earlier.bottom.size
            if transform is None and theirs != ours:
                raise ConfigError(
                    f"cannot resume in {path}: its mesh has {theirs} nodes, not {ours}"
                )
            before, size = self._earlier.attributes, self.path.stat().st_size
            kept = {name: before[name] for name in KEPT if name in before}
        basic = layout.frame_fields(tracers) | {x: self._about[x] for x in user_fields or {}}
        self._profiles = {n: x for n, x in (user_fields or {}).items() if hasattr(x, "dims")}
        wanted = {*only} or {*basic}
        if transform is not None and wanted & {"u", "v"}:
            wanted |= {"u", "v"}  # interpolated as a vector
        every = {
            name: {"long_name": FIELDS[name].title, "units": POWER.sub(r"\1", FIELDS[name].units)}
            for name in layout.VARIABLES["derived"]
        } | basic
        for name in sorted(wanted.difference(every)):
            raise unknown_name("field", name, [*every])
        self._fields = {name: each for name, each in every.items() if name in wanted}
        begun = "" if kept or "origin" not in attributes else f" from {attributes['origin']}"
        lines = str(kept.get("history", attributes.get("history", "")))
        line = layout.history(f"run {attributes.get('scene', '')}{begun}", lines)
        of_run = {"run_id": uuid.uuid4().hex, **attributes, **kept, "history": line}
        self._attributes = layout.plain(of_run)
        self.run_id = str(of_run["run_id"])
        """Identifier of the run; a resumed run keeps the identifier of the earlier run."""
        self._series: tuple[str, ...] = ()
        size += (layout.LAYOUT_BYTES + 8 * len(self._fields)) * mesh.size
        place = self.path.resolve() if self.path.is_symlink() else self.path
        with translate_errors(f"cannot write {self.path}"):
            in_zarr = self.path.suffix.lower() == SUFFIX
            self._growing: GrowingFile | GrowingStore = (
                GrowingStore(place) if in_zarr else GrowingFile(place, size)
            )
        self._begun = False

    def write(
        self, time: float, fields: Mapping[str, Array],
        diagnostics: Mapping[str, float | None] | None = None,
    ) -> None:  # fmt: skip
        """Append a frame at time [s since the start] and sync it to the disk.

        fields: h [m], u, v [m s-1], vorticity, divergence [s-1], q_NAME of tracers, custom ones
        (all (N,) or profiles); f, area for derived ones; b, f with `transform`; others are ignored.
        diagnostics: as for `record`, at the same time; those of the first frame define the series.
        """
        values: dict[str, Any] = {name: derive(fields, name) for name in self._fields}
        frame = None
        if self._transform is not None:
            every = {**fields, **values}
            frame = layout.frame_dataset(self._mesh, every, time, self._attributes, self._fields)
            frame = self._transform(frame)
            values = {name: frame[name] for name in self._fields}
        values = {"time": np.array([time])} | {n: np.asarray(x) for n, x in values.items()}
        with self._writing(begins=True):
            if not self._begun:
                self._make(diagnostics or {}, frame)
            self._growing.add_record(values)
            if diagnostics:
                self._growing.add_sample(self._sample(time, diagnostics))
            self._begun = True
            if self._earlier is None or self._growing.records >= self._earlier.times.size:
                self._growing.put_in_place()

    def record(self, time: float, diagnostics: Mapping[str, float | None]) -> None:
        """Append numbers at time [s] to the series along `diagnostic_time`, after a first frame.

        None and absent names are stored as missing. Raises RunFailed for a name that was absent in
        the first frame, and ValueError if the samples of a netCDF file exceed the expected number.
        """
        with self._writing():
            self._growing.add_sample(self._sample(time, diagnostics))

    def checkpoint(self, state_dict: Mapping[str, np.ndarray], steps: int) -> None:
        """Replace the checkpoint by one from which the run can be resumed bit for bit.

        state_dict: `Simulation.restart_arrays`; steps: those of the run.
        """
        checkpoint = Checkpoint({**state_dict}, steps, self._attributes)
        with self._writing():
            write_checkpoint(checkpoint_path(self.path), checkpoint)

    def finish(self, summary: Mapping[str, object]) -> None:
        """Write how the run ended, in JSON in the attribute `summary`; put the file in place.

        Entries that do not fit are omitted, from the end of the summary.
        """
        kept = dict(summary)
        while len(text := json.dumps(kept, default=str)) > layout.SUMMARY_BYTES:
            kept.popitem()
        with self._writing():
            self._growing.set_summary(text)
            self._growing.put_in_place()

    def close(self) -> None:
        """Close the file; may be called again, and after a failure."""
        self._growing.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _make(self, diagnostics: Iterable[str], frame: "xr.Dataset | None") -> None:
        """Write the whole file except new frames and samples; frame: the first one on a grid."""
        times, earlier = (np.zeros(0), {}) if self._earlier is None else self._earlier.series()
        self._series = tuple(dict.fromkeys((*diagnostics, *earlier)))
        about = {} if self._earlier is None else self._earlier.about_series
        series = {name: self._about.get(name) or about.get(name, {}) for name in self._series}
        times = times[times < self._from]
        if frame is not None:
            space = {layout.SUMMARY: " " * layout.SUMMARY_BYTES}
            data = frame.isel(time=slice(0)).assign_attrs(space)
        else:
            data = layout.file_dataset(
                self._mesh, self._attributes, self._bottom, self._coriolis, self._fields, series,
                self._samples + times.size, self._profiles,
            )  # fmt: skip
        self._growing.define(data)
        self._growing.set_summary(json.dumps({"completed": False}))
        if self._earlier is not None:
            self._copy_frames(data)
        for k, time in enumerate(times):
            sample = {name: earlier[name][k] for name in self._series if name in earlier}
            self._growing.add_sample(self._sample(time, sample))

    def _copy_frames(self, new: "xr.Dataset") -> None:
        """Copy the frames of the earlier run; raises ConfigError if they contain other fields.

        Frames that the run wrote after its last checkpoint are omitted: they are written again.
        """
        names = {"time", *self._fields}
        with reading(self.path) as data:
            ours, theirs = (
                {name: v.shape[1:] for name, v in of.variables.items() if "time" in v.dims}
                for of in (new, data)
            )
            if ours != theirs:
                raise ConfigError(f"cannot resume in {self.path}: its frames hold other fields")
            for k in range(self.kept_times.size):
                values = {n: read_values(self.path, n, data[n][k].variable) for n in names}
                self._growing.add_record(values, wait=False)

    def _sample(self, time: float, diagnostics: Mapping[str, float | None]) -> dict[str, float]:
        """Return a number for every series; raises RunFailed for a number without a series."""
        if late := ", ".join(sorted(diagnostics.keys() - set(self._series))):
            raise RunFailed(f"{self.path} has no series of {late}: register diagnostics before run")
        numbers = {name: diagnostics.get(name) for name in self._series}
        return {layout.SERIES: time} | {n: math.nan if x is None else x for n, x in numbers.items()}

    @contextmanager
    def _writing(self, begins: bool = False) -> Iterator[None]:
        """Raise RunFailed for errors of the disk, and for a file that another program changed."""
        if not (begins or self._begun):
            raise ValueError("the first record of a file must be a frame")
        with translate_errors(f"cannot write {self.path}", RunFailed, MENDING):
            self._growing.check(self.path)
            yield
