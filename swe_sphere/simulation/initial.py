"""Initial states that replace the one of the scene: a frame of any run, or a function."""

import hashlib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError, shown
from swe_sphere.io.scalar_fields import evaluate
from swe_sphere.planet import DAY


class Initial:
    """A state from which a run begins.

    given: a file or a dataset of a run, or a function as `Scene.initial`.  day: time of the frame
    [days], the last one for None.  Raises ConfigError where there is no such file or frame, or
    where the object is of another kind.
    """

    origin, identity, history = "a function", "a function", ""
    """Origin of the state, a short name that equal states share, and the history of its file."""

    def __init__(self, given: Any, day: float | None) -> None:
        import xarray as xr  # takes its time to import

        from swe_sphere.analysis.accessor import Analysis
        from swe_sphere.io.runfile import Frame, RunFile

        self._given, self._points = given, np.empty(0)
        time = None if day is None else day * DAY
        if callable(given) and day is None:
            return
        if isinstance(given, xr.Dataset):
            name, frame = "a dataset", Analysis(given).frame(time)
        elif isinstance(given, str | Path):
            run = RunFile(given)
            time = run.nearest(time)
            name, frame = Path(given).name, Frame(run.mesh, run.frame(time), time, run.attributes)
        else:
            also = "" if day is None else "; initial-time chooses a frame of it"
            raise ConfigError(
                f"initial: give a file, a dataset or a function, got {shown(given)}{also}"
            )
        self._frame, digest = frame, hashlib.sha256()
        for field, values in sorted(frame.fields.items()):
            digest.update(field.encode() + np.ascontiguousarray(values).tobytes())
        self.origin, self.identity = f"{name} at day {frame.time / DAY:g}", digest.hexdigest()[:16]
        self.history = str(frame.attributes.get("history", ""))

    def begin(self, scene: Scene) -> Scene:
        """Return the scene with this initial state, and without exact solutions.

        What is prescribed in time (wind, forcing) continues from the time of the frame.  A tracer
        that the frame lacks begins as in the scene.  Raises ConfigError where the frame lacks depth
        or wind, or where a value is not finite.
        """
        changes: dict[str, Any] = {"exact": None, "exact_tracers": None}
        if callable(self._given):
            return replace(scene, **changes | {"initial": self._given})
        fields, tracers = self._frame.fields, dict(scene.tracers or {})
        known = {name: f"q_{name}" for name in tracers if f"q_{name}" in fields}
        for name in ("h", *(() if scene.wind else ("u", "v")), *known.values()):
            if name not in fields:
                raise ConfigError(f"initial: {self.origin} lacks the field {name}: take another")
            if not np.isfinite(fields[name]).all():
                raise ConfigError(
                    f"initial: {name} is not finite in {self.origin}: take an earlier frame"
                    " (initial-time)"
                )
        changes["initial"] = partial(self._state, scene.wind is None)
        if known:
            changes["tracers"] = tracers | {k: partial(self._at, q) for k, q in known.items()}
        for name in ("wind", "forcing"):
            if (prescribed := getattr(scene, name)) is not None:
                changes[name] = partial(_later, prescribed.function, self._frame.time)
        return replace(scene, **changes)

    def _state(self, moves: bool, lon: Array, lat: Array) -> tuple[Any, Any, Array]:
        """Return u, v [m s-1] and h [m]; moves: False where the wind is prescribed."""
        u, v = self._at("wind", lon, lat) if moves else (0.0, 0.0)
        return u, v, self._at("h", lon, lat)

    def _at(self, name: str, lon: Array, lat: Array) -> Array:
        """Evaluate a field: at the nodes of its mesh bit for bit, else in the elements."""
        frame, points = self._frame, np.array((lon, lat))
        if np.array_equal(points, frame.points):
            return frame.values(name)
        if not np.array_equal(points, self._points):
            self._points, self._sampler = points, frame.sampler(lon, lat)
        return evaluate(self._sampler, frame.fields, name)


def _later(function: Callable[..., Any], by: float, lon: Array, lat: Array, time: float) -> Any:
    return function(lon, lat, time + by)
