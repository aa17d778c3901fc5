"""Errors of runs: against a time-converged run, in total, and of the slow flow."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from swe_sphere.io.norms import area_mean, norms
from swe_sphere.io.scalar_fields import evaluate
from swe_sphere.mesh import Interpolator, Mesh
from swe_sphere.operators.diagnose import vorticity
from swe_sphere.planet import DAY
from swe_sphere.simulation.snapshot import Fields
from swe_sphere.studies.sweep.discretisation import Discretisation, Discretisations, History
from swe_sphere.studies.sweep.record import Errors
from swe_sphere.studies.sweep.sweep_plan import SweepPlan

if TYPE_CHECKING:
    from swe_sphere.studies.sweep.references import ReferenceRuns, TotalReference

__all__ = ["Evaluator", "Norms", "field_errors", "listed", "slow_errors"]


SHEDDING = ("williamson5", "williamson6")
"""Scenes whose start sheds gravity waves, so that depth alone does not rank steppers."""


class Evaluator:
    """Takes the errors of runs; what they are taken against is made when it is first asked for."""

    def __init__(
        self,
        plan: SweepPlan,
        spaces: Discretisations,
        total: TotalReference,
        runs: ReferenceRuns,
    ) -> None:
        self._plan, self._spaces, self._total, self._runs = plan, spaces, total, runs
        scene = spaces.all()[0].scene.name
        self._slow = (scene in SHEDDING) if plan.slow is None else plan.slow
        self._converged: dict[tuple[int, int], History] = {}
        self._at_nodes: dict[tuple[str, float], Fields | None] = {}
        self._on_grid: dict[tuple[str, float], _OnGrid] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """What errors are taken against: part of the identity of a run whose errors are taken."""
        time = f"{self._plan.converged_stepper} at {self._plan.converged_part:g} of its limit"
        return (time, self._total.name, *(["slow flow"] if self._slow else []))

    def __call__(self, space: Discretisation, history: History) -> list[Errors]:
        """Errors of all kinds of the fields at report days."""
        found = self.total_errors(space, history)
        converged = self.converged(space)
        for day in history.keys() & converged.keys():
            pair = (space, history[day], converged[day])
            found += listed("time", day, field_errors(*pair))
            found += listed("slow", day, slow_errors(*pair)) if self._slow else []
        return found

    def converged(self, space: Discretisation) -> History:
        """Fields at report days of a run converged in time, on the same mesh in float64."""
        key = (space.mesh.ne, space.mesh.np)
        if key not in self._converged:
            exact = self._spaces.at(*key)
            made = self._runs.converged(
                exact, self._plan.converged_stepper, self._plan.converged_part, self.total_errors
            )
            self._converged[key] = made
        return self._converged[key]

    def total_errors(self, space: Discretisation, history: History) -> list[Errors]:
        """The total errors alone."""
        return [
            error
            for day, fields in history.items()
            for error in listed("total", day, self._total_norms(space, day, fields))
        ]

    def _total_norms(self, space: Discretisation, day: float, fields: Fields) -> Norms:
        key = (space.identity, day)
        if self._total.kind == "file":
            if day not in self._total.files:
                return {}
            if key not in self._on_grid:
                self._on_grid[key] = _OnGrid(self._total.files[day], space.mesh)
            return self._on_grid[key].errors(space, fields)
        if key not in self._at_nodes:
            self._at_nodes[key] = self._reference(space, day)
        theirs = self._at_nodes[key]
        return {} if theirs is None else field_errors(space, fields, theirs)

    def _reference(self, space: Discretisation, day: float) -> Fields | None:
        """The exact solution, or that of the finer run, at the nodes."""
        if self._total.kind == "exact":
            return _exact_fields(space, day)
        if self._total.kind == "none":
            return None
        fine = self._spaces.at(self._total.finer, max(self._spaces.np))
        history = self._runs.finer(fine)
        return _interpolated(fine.mesh, history[day], space.mesh) if day in history else None


Norms = dict[str, dict[str, float]]
"""l1, l2 and linf by field."""


def field_errors(space: Discretisation, ours: Fields, theirs: Fields) -> Norms:
    """Errors at the nodes of height, wind and vorticity; just of height of a prescribed wind."""
    surface = space.scene.error_field == "surface"
    bottom = space.start["b"] if surface else 0.0
    pairs = {"h": (ours["h"] + bottom, theirs["h"] + bottom)}
    if space.scene.wind is None:
        pairs["v"] = (_wind(ours), _wind(theirs))
        pairs["vorticity"] = (ours["vorticity"], theirs["vorticity"])
    return {name: norms(space.mesh.area, *pair) for name, pair in pairs.items()}


def slow_errors(space: Discretisation, ours: Fields, theirs: Fields) -> Norms:
    """Errors at the nodes of potential vorticity, in the place of those of vorticity.

    Gravity waves carry none, so that waves which a long step has damped or dephased do not count.
    """
    if space.scene.wind is not None:
        return {}
    coriolis, mean = space.start["f"], area_mean(space.mesh.area, theirs["h"])
    return {
        "vorticity": norms(
            space.mesh.area, *(_stretched(state, coriolis, mean) for state in (ours, theirs))
        )
    }


def listed(kind: str, day: float, errors: Norms) -> list[Errors]:
    """Errors as they are kept."""
    return [Errors(kind=kind, field=name, day=day, **values) for name, values in errors.items()]  # type: ignore[arg-type]


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

    def errors(self, space: Discretisation, fields: Fields) -> Norms:
        """Errors at the points of the grid."""
        ours = fields | {"b": space.start["b"]}
        return {
            field: norms(self._area, evaluate(self._interpolator, ours, name), self._values[name])
            for field, name in self._names.items()
        }


def _interpolated(fine: Mesh, fields: Fields, mesh: Mesh) -> Fields:
    interpolator = Interpolator(fine, mesh.lon, mesh.lat)
    u, v = evaluate(interpolator, fields, "wind")
    scalars = {name: interpolator(fields[name]) for name in ("h", "vorticity")}
    return {"u": u, "v": v} | scalars


def _exact_fields(space: Discretisation, day: float) -> Fields:
    """The exact solution; its vorticity is that of the exact wind, differentiated on the mesh."""
    scene, mesh = space.scene, space.mesh
    assert scene.exact is not None
    fields = dict(zip("uvh", scene.exact(mesh.lon, mesh.lat, day * DAY), strict=True))
    fields["vorticity"] = vorticity(mesh, fields["u"], fields["v"])
    return fields


def _stretched(state: Fields, coriolis: NDArray[np.float64], mean: float) -> NDArray[np.float64]:
    """H q - f (N,) [s-1]: the vorticity of columns that are brought to the mean depth H [m]."""
    return (state["vorticity"] + coriolis) * mean / state["h"] - coriolis


def _wind(fields: Fields) -> NDArray[np.float64]:
    return np.stack([fields["u"], fields["v"]])
