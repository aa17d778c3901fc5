"""Errors of runs: against a time-converged run, in total, and of the slow flow."""

from dataclasses import replace
from pathlib import Path

import xarray as xr

from swe_sphere.files.durable import write_whole
from swe_sphere.io.integrals import Norms
from swe_sphere.io.reference_solution import OnGrid, Reference
from swe_sphere.operators.diagnose import vorticity
from swe_sphere.planet import DAY
from swe_sphere.simulation.diagnostics import Fields, exact_fields, flow_errors, slow_errors
from swe_sphere.studies.record_store import as_netcdf
from swe_sphere.studies.sweep.record import Errors, RunRecord
from swe_sphere.studies.sweep.runner import KEPT, Runner
from swe_sphere.studies.sweep.runs import Discretisation, History, RunSpec, Study

CONVERGED = "converged"
"""Folder of the fields of reference runs."""
STEPPER, PART = "rk4", 0.25
"""Explicit stepper of the time-converged run, and its step as a part of its stability limit."""


class Evaluator:
    """Takes the errors of runs; what they are taken against is made when it is first asked for.

    Runs made for it have no time limit.  Their fields are kept in the folder and read again; where
    one fails there is a record that tells why, and no fields.
    """

    def __init__(self, study: Study, runner: Runner, folder: Path) -> None:
        self._study, self._runner, self._folder = study, runner, folder / CONVERGED
        self._converged: dict[tuple[int, int], History] = {}
        self._right: dict[tuple[str, float], OnGrid | Fields | None] = {}

    def __call__(self, space: Discretisation, history: History) -> list[Errors]:
        """Errors of all kinds of the fields at report days."""
        converged = self.converged(space)
        days, model = [day for day in history if day in converged], space.sim.model
        found = self._total_errors(space, history)
        for kind, errors in {"time": flow_errors, "slow": slow_errors}.items():
            if kind == "time" or self._study.slow:
                of_days = {day: errors(model, history[day], converged[day]) for day in days}
                found += Errors.of(kind, of_days)
        return found

    # --- against the run converged in time

    def converged(self, space: Discretisation) -> History:
        """Fields at report days of a run converged in time, on the same mesh in float64.

        A run of twice the step tells by Richardson's rule how large its own error in time is; the
        records of both hold these errors, and the total ones.
        """
        key = (space.mesh.ne, space.mesh.np)
        if key not in self._converged:
            study = self._study
            integrator = study.integrator(study.at(*key), STEPPER)
            longest = 2.0 * PART * integrator.stable_dt
            twice = study.steps(min(longest, study.interval), automatic=True)
            once = replace(twice, dt=0.5 * twice.dt, steps=2 * twice.steps,
                           frame_steps=2 * twice.frame_steps)  # fmt: skip
            coarse, fine = (
                RunSpec(integrator, steps.dt, steps, "converged", integrator.refusal)
                for steps in (twice, once)
            )
            if self._kept(fine) is None:
                self._compare(coarse, fine)
            self._converged[key] = self._kept(fine) or {}
        return self._converged[key]

    def _compare(self, coarse: RunSpec, fine: RunSpec) -> None:
        """Make both runs and keep what each says of the other."""
        made = {spec: self._runner.make(spec) for spec in (coarse, fine)}
        ours, right = (fields for _, fields in made.values())
        integrator, space = fine.integrator, fine.integrator.space
        apart = {
            day: flow_errors(space.sim.model, ours[day], right[day]) for day in ours if day in right
        }
        gain = 2.0 ** integrator.kind.order_in(space.sim.model, **integrator.options)
        for spec, share in ((coarse, gain / (gain - 1.0)), (fine, 1.0 / (gain - 1.0))):
            record, fields = made[spec]
            errors = Errors.of("time", apart, share) + self._total_errors(space, fields)
            self._keep(spec, record.model_copy(update={"errors": errors}), fields)

    def _kept(self, spec: RunSpec) -> History | None:
        """Fields at report days of a run, none if it failed; None where it is yet to be made."""
        known = self._runner.known(spec)
        if known is None or known.status != "completed":
            return None if known is None else {}
        try:
            found = xr.load_dataset(self._folder / f"{spec.key}.nc", engine="netcdf4")
            return {
                float(day): {name: found[name].sel(report_day=day).values for name in KEPT}
                for day in found["report_day"].values
            }
        except (OSError, LookupError):
            return None

    def _keep(self, spec: RunSpec, record: RunRecord, history: History) -> None:
        """Fields first: what there is a record of has been written."""
        if record.status == "completed":
            fields = {name: [of[name] for of in history.values()] for name in KEPT}
            variables = {name: (("report_day", "node"), of) for name, of in fields.items()}
            whole = xr.Dataset(variables, {"report_day": [*history]}, {"title": spec.label})
            write_whole(self._folder / f"{spec.key}.nc", as_netcdf(whole))
        if self._runner.known(spec) is None:
            self._runner.keep(record)

    # --- in total

    def _total_errors(self, space: Discretisation, history: History) -> list[Errors]:
        """The total errors alone: against a file of the day, or the exact solution at the nodes."""
        found: dict[float, Norms] = {}
        for day, fields in history.items():
            key = (space.identity, day)
            if key not in self._right:
                self._right[key] = self._reference(space, day)
            right = self._right[key]
            if isinstance(right, OnGrid):
                whole = fields | {"b": space.sim.start["b"]}
                found[day] = right.errors(whole, space.scene.error_field)
            elif right is not None:
                found[day] = flow_errors(space.sim.model, fields, right)
        return Errors.of("total", found)

    def _reference(self, space: Discretisation, day: float) -> OnGrid | Fields | None:
        if self._study.files:
            path = self._study.files.get(day)
            return OnGrid(Reference(path), space.mesh) if path else None
        if space.scene.exact is None:
            return None
        fields = exact_fields(space.sim.model, day * DAY)
        # its vorticity is that of the exact wind on the mesh
        return fields | {"vorticity": vorticity(space.mesh, fields["u"], fields["v"])}
