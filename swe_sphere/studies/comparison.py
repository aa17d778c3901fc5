"""Errors of a state against what is right: an exact solution, one on a grid, or another run."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.equations.scene import Scene
from swe_sphere.io.norms import area_mean, norms
from swe_sphere.io.scalar_fields import evaluate
from swe_sphere.mesh import Interpolator, Mesh
from swe_sphere.simulation.snapshot import Fields

Norms = dict[str, dict[str, float]]
"""l1, l2 and linf by field."""


class Place(Protocol):
    """A scene on a mesh, as a simulation has it."""

    @property
    def scene(self) -> Scene:
        """The scene."""

    @property
    def mesh(self) -> Mesh:
        """The mesh."""

    @property
    def start(self) -> Fields:
        """All fields at the start with bottom b [m] and Coriolis parameter f [s-1], each (N,)."""


def exact_fields(place: Place, time: float) -> Fields:
    """u, v, h (N,) of a scene that has an exact solution, at a time [s]."""
    assert place.scene.exact is not None
    exact = place.scene.exact(place.mesh.lon, place.mesh.lat, time)
    return dict(zip("uvh", exact, strict=True))


def at_nodes(fine: Mesh, fields: Fields, mesh: Mesh) -> Fields:
    """u, v, h and, where it is there, vorticity of a finer mesh at the nodes of another."""
    interpolator = Interpolator(fine, mesh.lon, mesh.lat)
    u, v = evaluate(interpolator, fields, "wind")
    scalars = fields.keys() & {"h", "vorticity"}
    return {"u": u, "v": v} | {name: interpolator(fields[name]) for name in scalars}


def field_errors(place: Place, ours: Fields, theirs: Fields) -> Norms:
    """Errors at the nodes of height, wind and, where theirs has it, vorticity.

    A prescribed wind has no error, nor has its vorticity; heights are those of the scene's
    `error_field`.
    """
    bottom = place.start["b"] if place.scene.error_field == "surface" else 0.0
    pairs = {"h": (ours["h"] + bottom, theirs["h"] + bottom)}
    if place.scene.wind is None:
        pairs["v"] = (_wind(ours), _wind(theirs))
        if "vorticity" in theirs:
            pairs["vorticity"] = (ours["vorticity"], theirs["vorticity"])
    return {name: norms(place.mesh.area, *pair) for name, pair in pairs.items()}


def slow_errors(place: Place, ours: Fields, theirs: Fields) -> Norms:
    """Errors at the nodes of potential vorticity, in the place of those of vorticity.

    Gravity waves carry none, so that waves which a long step has damped or dephased do not count.
    """
    if place.scene.wind is not None:
        return {}
    area, coriolis = place.mesh.area, place.start["f"]
    mean = area_mean(area, theirs["h"])
    slow = (_stretched(state, coriolis, mean) for state in (ours, theirs))
    return {"vorticity": norms(area, *slow)}


class OnGrid:
    """A reference on a grid with the matrix that takes a mesh there, which takes time to make."""

    def __init__(self, path: Path, mesh: Mesh) -> None:
        from swe_sphere.io.reference_solution import Reference  # needs scipy's splines

        reference = Reference(path)
        has = reference.fields.keys()
        names = {"h": "surface" if "surface" in has else "h", "vorticity": "vorticity"}
        names = {field: name for field, name in names.items() if name in has}
        if {"u", "v"} <= has:
            names["v"] = "wind"
        self._names, self._area = names, reference.area
        self._values = {name: reference.values(name) for name in names.values()}
        self._interpolator = Interpolator(mesh, *reference.points)

    def errors(self, fields: Fields) -> Norms:
        """Errors at the points of the grid of u, v, h, vorticity with the bottom b, each (N,)."""
        return {
            field: norms(self._area, self._ours(fields, name), self._values[name])
            for field, name in self._names.items()
        }

    def decorrelation(self, fields: Fields) -> float:
        """1 less the correlation of vorticity with that of the reference."""
        pair = self._ours(fields, "vorticity"), self._values["vorticity"]
        covariance = np.cov(*pair, aweights=self._area)
        return 1.0 - float(covariance[0, 1]) / float(np.sqrt(covariance[0, 0] * covariance[1, 1]))

    def _ours(self, fields: Fields, name: str) -> Array:
        return evaluate(self._interpolator, fields, name)


def _stretched(state: Fields, coriolis: Array, mean: float) -> Array:
    """H q - f (N,) [s-1]: the vorticity of columns that are brought to the mean depth H [m]."""
    return (state["vorticity"] + coriolis) * mean / state["h"] - coriolis


def _wind(fields: Fields) -> Array:
    return np.stack([fields["u"], fields["v"]])
