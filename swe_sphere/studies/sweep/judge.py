"""Errors of a run: against a time-converged run, against the truth, and of the slow flow."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from swe_sphere.io.norms import area_mean, norms
from swe_sphere.io.scalar_fields import evaluate
from swe_sphere.mesh import Interpolator, Mesh
from swe_sphere.operators.diagnose import vorticity
from swe_sphere.planet import DAY
from swe_sphere.studies.sweep.bench import Bench, Fields

__all__ = [
    "ERRORS", "KINDS", "NORMS", "Errors", "Exact", "FinerRun", "References", "SameMesh", "SlowFlow",
    "Truth", "field_errors",
]  # fmt: skip

KINDS = ("time", "total", "slow")
ERRORS = ("h", "v", "vorticity")
NORMS = ("l1", "l2", "linf")

Errors = dict[str, dict[str, float]]
"""Norms by field and name of the norm."""


class Truth(Protocol):
    """Something that a run is compared with."""

    def errors(self, bench: Bench, day: float, fields: Fields) -> Errors:
        """Errors of the fields at the nodes at a report day; empty where nothing is known."""


class SameMesh:
    """Fields at report days on the very mesh of the runs."""

    def __init__(self, fields: Mapping[float, Fields]) -> None:
        self._fields = fields

    def errors(self, bench: Bench, day: float, fields: Fields) -> Errors:
        """Errors at the nodes."""
        theirs = self._fields.get(day)
        return {} if theirs is None else field_errors(bench, fields, theirs)


class SlowFlow:
    """The slow part of the flow on the very mesh of the runs: its potential vorticity.

    Gravity waves carry none, so that waves which a long step has damped or dephased do not count;
    the error stands in the place of that of vorticity.
    """

    def __init__(self, fields: Mapping[float, Fields]) -> None:
        self._fields = fields

    def errors(self, bench: Bench, day: float, fields: Fields) -> Errors:
        """Errors at the nodes."""
        theirs = self._fields.get(day)
        if theirs is None or bench.scene.wind is not None:
            return {}
        mean = area_mean(bench.mesh.area, theirs["h"])
        ours, right = (_potential_vorticity(bench, state, mean) for state in (fields, theirs))
        return {"vorticity": norms(bench.mesh.area, ours, right)}


class Exact:
    """The exact solution; its vorticity is that of the exact wind, differentiated on the mesh."""

    def __init__(self) -> None:
        self._known: dict[tuple[int, float], Fields] = {}

    def errors(self, bench: Bench, day: float, fields: Fields) -> Errors:
        """Errors at the nodes."""
        key = (id(bench), day)
        if key not in self._known:
            self._known[key] = _exact_fields(bench, day)
        return field_errors(bench, fields, self._known[key])


class References:
    """Independent solutions on latitude-longitude grids, each of one report day."""

    def __init__(self, files: Mapping[float, Path]) -> None:
        self._files = files
        self._known: dict[tuple[int, float], _OnGrid] = {}

    def errors(self, bench: Bench, day: float, fields: Fields) -> Errors:
        """Errors at the points of the grid."""
        if day not in self._files:
            return {}
        key = (id(bench), day)
        if key not in self._known:
            self._known[key] = _OnGrid(self._files[day], bench.mesh)
        return self._known[key].errors(bench, fields)


class FinerRun:
    """A run on a finer mesh, interpolated to the nodes of the runs."""

    def __init__(self, mesh: Mesh, fields: Mapping[float, Fields]) -> None:
        self._mesh, self._fields = mesh, fields
        self._known: dict[tuple[int, float], Fields] = {}

    def errors(self, bench: Bench, day: float, fields: Fields) -> Errors:
        """Errors at the nodes of the runs."""
        if day not in self._fields:
            return {}
        key = (id(bench), day)
        if key not in self._known:
            self._known[key] = self._interpolated(bench, self._fields[day])
        return field_errors(bench, fields, self._known[key])

    def _interpolated(self, bench: Bench, fine: Fields) -> Fields:
        interpolator = Interpolator(self._mesh, bench.mesh.lon, bench.mesh.lat)
        u, v = evaluate(interpolator, fine, "wind")
        return {"u": u, "v": v, "h": interpolator(fine["h"]),
                "vorticity": interpolator(fine["vorticity"])}  # fmt: skip


class _OnGrid:
    """A reference with the matrix that takes a mesh to its points, which takes time to make."""

    def __init__(self, path: Path, mesh: Mesh) -> None:
        from swe_sphere.io.reference_solution import Reference  # needs scipy's splines

        reference = Reference(path)
        has = reference.fields.keys()
        names = {"h": "surface" if "surface" in has else "h", "vorticity": "vorticity"}
        names = {field: name for field, name in names.items() if name in has}
        if {"u", "v"} <= has:
            names["v"] = "wind"
        self._names = names
        self._values = {name: reference.values(name) for name in names.values()}
        self._area, self._interpolator = reference.area, Interpolator(mesh, *reference.points)

    def errors(self, bench: Bench, fields: Fields) -> Errors:
        ours = fields | {"b": bench.start["b"]}
        return {
            field: norms(self._area, evaluate(self._interpolator, ours, name), self._values[name])
            for field, name in self._names.items()
        }


def field_errors(bench: Bench, ours: Fields, theirs: Fields) -> Errors:
    """Errors at the nodes of height, wind and vorticity; just of height where the wind is given."""
    surface = bench.scene.error_field == "surface"
    bottom = bench.start["b"] if surface else 0.0
    pairs = {"h": (ours["h"] + bottom, theirs["h"] + bottom)}
    if bench.scene.wind is None:
        pairs["v"] = (_wind(ours), _wind(theirs))
        pairs["vorticity"] = (ours["vorticity"], theirs["vorticity"])
    return {name: norms(bench.mesh.area, *pair) for name, pair in pairs.items()}


def _potential_vorticity(bench: Bench, state: Fields, mean: float) -> NDArray[np.float64]:
    """H q - f (N,) [s-1]: the vorticity of columns that are brought to the mean depth H [m]."""
    coriolis = bench.start["f"]
    return (state["vorticity"] + coriolis) * mean / state["h"] - coriolis


def _wind(fields: Fields) -> NDArray[np.float64]:
    return np.stack([fields["u"], fields["v"]])


def _exact_fields(bench: Bench, day: float) -> Fields:
    scene, mesh = bench.scene, bench.mesh
    assert scene.exact is not None
    fields = dict(zip("uvh", scene.exact(mesh.lon, mesh.lat, day * DAY), strict=True))
    fields["vorticity"] = vorticity(mesh, fields["u"], fields["v"])
    return fields
