"""Errors of runs: against a time-converged run, in total, and of the slow flow."""

from __future__ import annotations

from swe_sphere.operators.diagnose import vorticity
from swe_sphere.planet import DAY
from swe_sphere.simulation.snapshot import Fields
from swe_sphere.studies.errors import (
    Norms,
    OnGrid,
    at_nodes,
    exact_fields,
    field_errors,
    slow_errors,
)
from swe_sphere.studies.sweep.discretisation import Discretisation, Discretisations, History
from swe_sphere.studies.sweep.record import Errors
from swe_sphere.studies.sweep.references import ReferenceRuns, TotalReference
from swe_sphere.studies.sweep.sweep_plan import SweepPlan

__all__ = ["Evaluator"]


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
        self._on_grid: dict[tuple[str, float], OnGrid] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """What errors are taken against: part of the identity of a run whose errors are taken."""
        time = f"{self._plan.converged_stepper} at {self._plan.converged_part:g} of its limit"
        return (time, self._total.name, *(["slow flow"] if self._slow else []))

    def __call__(self, space: Discretisation, history: History) -> list[Errors]:
        """Errors of all kinds of the fields at report days."""
        converged = self.converged(space)
        days = [day for day in history if day in converged]
        kinds = {"time": field_errors} | ({"slow": slow_errors} if self._slow else {})
        found = self.total_errors(space, history)
        for kind, errors in kinds.items():
            of_days = {day: errors(space, history[day], converged[day]) for day in days}
            found += Errors.of(kind, of_days)
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
        norms = {day: self._total_norms(space, day, fields) for day, fields in history.items()}
        return Errors.of("total", norms)

    def _total_norms(self, space: Discretisation, day: float, fields: Fields) -> Norms:
        key = (space.identity, day)
        if self._total.kind == "file":
            if day not in self._total.files:
                return {}
            if key not in self._on_grid:
                self._on_grid[key] = OnGrid(self._total.files[day], space.mesh)
            return self._on_grid[key].errors(fields | {"b": space.start["b"]})
        if key not in self._at_nodes:
            self._at_nodes[key] = self._reference(space, day)
        theirs = self._at_nodes[key]
        return {} if theirs is None else field_errors(space, fields, theirs)

    def _reference(self, space: Discretisation, day: float) -> Fields | None:
        """The exact solution, or that of the finer run, at the nodes."""
        if self._total.kind == "exact":
            return _exact(space, day)
        if self._total.kind == "none":
            return None
        fine = self._spaces.at(self._total.finer, max(self._spaces.np))
        history = self._runs.finer(fine)
        return at_nodes(fine.mesh, history[day], space.mesh) if day in history else None


def _exact(space: Discretisation, day: float) -> Fields:
    """The exact solution; its vorticity is that of the exact wind, differentiated on the mesh."""
    fields = exact_fields(space, day * DAY)
    return fields | {"vorticity": vorticity(space.mesh, fields["u"], fields["v"])}
