"""Initial states that replace the one of the scene: a frame of any run, or a function."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError, shown
from swe_sphere.io.scalar_fields import Sampler, derive, evaluate
from swe_sphere.planet import DAY

if TYPE_CHECKING:
    from swe_sphere.io.runfile import Frame


@dataclass(frozen=True)
class Initial:
    """A state from which a run begins.

    function: as `Scene.initial`; None where a frame holds the state.
    """

    function: Callable[..., Any] | None = None
    frame: Frame | None = None
    origin: str = "a function"
    """Where the state comes from, in words."""
    history: str = ""
    """History of the file that holds the frame."""

    @property
    def identity(self) -> str:
        """Short name of the state: equal for equal fields, and for all functions."""
        if self.frame is None:
            return self.origin
        digest = hashlib.sha256()
        for name, values in sorted(self.frame.fields.items()):
            digest.update(name.encode() + np.ascontiguousarray(values).tobytes())
        return digest.hexdigest()[:16]

    def begin(self, scene: Scene) -> Scene:
        """Return the scene with this initial state, and without exact solutions.

        What is prescribed in time (wind, forcing) continues from the time of the frame.  A tracer
        that the frame lacks begins as in the scene.  Raises ConfigError where the frame lacks depth
        or wind, or where a value is not finite.
        """
        changes: dict[str, Any] = {"exact": None, "exact_tracers": None}
        if self.frame is None:
            changes["initial"] = self.function
            return replace(scene, **changes)
        frame, tracers = self.frame, scene.tracers or {}
        known = [name for name in tracers if f"q_{name}" in frame.fields]
        needed = ["h"] if scene.wind else ["u", "v", "h"]
        for name in (*needed, *(f"q_{name}" for name in known)):
            if name not in frame.fields:
                raise ConfigError(f"initial: {self.origin} lacks the field {name}: take another")
            if not np.isfinite(frame.fields[name]).all():
                raise ConfigError(
                    f"initial: {name} is not finite in {self.origin}: take an earlier frame"
                    " (initial-time)"
                )
        at = _Evaluation(frame)
        changes["initial"] = partial(_state, at, not scene.wind)
        if known:
            changes["tracers"] = {**tracers, **{k: partial(at, f"q_{k}") for k in known}}
        for name in ("wind", "forcing"):
            if (prescribed := getattr(scene, name)) is not None:
                changes[name] = partial(_later, prescribed.function, frame.time)
        return replace(scene, **changes)


class _Evaluation:
    """Evaluates the fields of a frame; the values at the last points are kept.

    At the nodes of its own mesh they are those of the frame, bit for bit, and elsewhere those of
    the polynomials in its elements.
    """

    def __init__(self, frame: Frame) -> None:
        self._frame = frame
        self._points: Array | None = None
        self._sampler: Sampler | None = None
        self._known: dict[str, Array] = {}

    def __call__(self, name: str, lon: Array, lat: Array) -> Array:
        frame = self._frame
        if self._points is None or not np.array_equal(self._points, (lon, lat)):
            self._points, self._known = np.array((lon, lat)), {}
            is_own = np.array_equal(self._points, frame.points)
            self._sampler = None if is_own else frame.sampler(lon, lat)
        if name not in self._known:
            at, fields = self._sampler, frame.fields
            self._known[name] = derive(fields, name) if at is None else evaluate(at, fields, name)
        return self._known[name]


def _state(at: _Evaluation, moves: bool, lon: Array, lat: Array) -> tuple[Any, Any, Array]:
    """Return u, v [m s-1] and h [m] of a frame; moves: False where the wind is prescribed."""
    u, v = at("wind", lon, lat) if moves else (0.0, 0.0)
    return u, v, at("h", lon, lat)


def _later(function: Callable[..., Any], by: float, lon: Array, lat: Array, time: float) -> Any:
    return function(lon, lat, time + by)


def read_initial(given: Any, day: float | None) -> Initial | None:
    """Return the initial state in a file, a dataset or a function; None where none is given.

    day: time of the frame [days], the last one for None.  Raises ConfigError where there is no such
    file or frame, or where the object is of another kind.
    """
    if day is not None and (given is None or callable(given)):
        raise ConfigError("initial-time: it chooses a frame of the file initial: give both")
    if given is None:
        return None
    if callable(given):
        return Initial(given)
    import xarray as xr  # takes its time to import

    from swe_sphere.analysis.accessor import Analysis
    from swe_sphere.io.runfile import Frame, RunFile

    time = None if day is None else day * DAY
    if isinstance(given, xr.Dataset):
        name, frame = "a dataset", Analysis(given).frame(time)
    elif isinstance(given, str | Path):
        run = RunFile(given)
        time = run.nearest(time)
        name, frame = Path(given).name, Frame(run.mesh, run.frame(time), time, run.attributes)
    else:
        raise ConfigError(f"initial: give a file, a dataset or a function, not {shown(given)}")
    origin = f"{name} at day {frame.time / DAY:g}"
    return Initial(frame=frame, origin=origin, history=str(frame.attributes.get("history", "")))
