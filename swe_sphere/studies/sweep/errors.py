"""Errors of runs: against a time-converged run, in total, and of the slow flow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
from swe_sphere.files.durable import write_whole
from swe_sphere.files.fingerprints import SCENE_FILE, code_fingerprint, file_fingerprint, processor
from swe_sphere.io.norms import Norms
from swe_sphere.io.reference_solution import OnGrid, Reference, shipped_reference
from swe_sphere.io.scalar_fields import at_nodes
from swe_sphere.operators import find_device
from swe_sphere.operators.diagnose import vorticity
from swe_sphere.planet import DAY
from swe_sphere.simulation.build import make_scene, start_warp
from swe_sphere.simulation.config import make_config
from swe_sphere.simulation.diagnostics import Fields, exact_fields, flow_errors, slow_errors
from swe_sphere.simulation.restart import scene_sources
from swe_sphere.studies.record_store import as_netcdf
from swe_sphere.studies.sweep.record import Errors
from swe_sphere.studies.sweep.runner import KEPT, Result, Runner
from swe_sphere.studies.sweep.runs import (
    Discretisation,
    Discretisations,
    History,
    Integrator,
    RunSpec,
    users_fingerprint,
)

SHIPPED: dict[str, tuple[str, tuple[str, ...]]] = {
    "williamson5": ("williamson5", ()),
    "williamson6": ("williamson6", ()),
    "galewsky": ("galewsky", ()),
    "galewsky_viscous": ("galewsky", ("viscosity.nu=1e5",)),
}
"""Solutions that come with the package: the scene and the settings of each."""

CODE, MACHINE = "the code of swe_sphere", "the processor"
"""Among what rows are made of: times of one machine say nothing of those of another."""


@dataclass(frozen=True)
class TotalReference:
    """What the total error is taken against, before anything is computed."""

    kind: str
    """exact, file, finer or none."""
    files: Mapping[float, Path] = field(default_factory=dict)
    """Of reference solutions, by report day."""
    finer: int = 0
    """ne of the finer run."""

    @property
    def sources(self) -> dict[str, str]:
        """Fingerprints of the files, by what they are."""
        return {
            f"the reference of day {day:g}": file_fingerprint(path)
            for day, path in self.files.items()
        }

    @property
    def name(self) -> str:
        """The reference in words, the contents of files included as a fingerprint."""
        if self.kind == "file":
            return str(self.sources)
        return f"finer run, ne {self.finer}" if self.kind == "finer" else self.kind


def sweep_sources(spaces: Discretisations, total: TotalReference) -> dict[str, str]:
    """Fingerprints of all that every row of a sweep is made of but its settings, by what it is.

    Scenes of one name are told apart by where they come from: the package, a file or an object.
    """
    files = scene_sources(spaces.plan.scene, spaces.scene)
    place = "a file" if SCENE_FILE in files else "the package"
    origin = place if spaces.own is None else users_fingerprint(spaces.own.initial)
    start_warp()
    made = {CODE: code_fingerprint(), MACHINE: processor(find_device(spaces.plan.device))}
    return {**made, "the scene": origin, **files, **total.sources}


def choose_reference(spaces: Discretisations) -> TotalReference:
    """Files of the user, else the exact solution, else files of the package, else a finer run.

    The finer run has the ne that the plan says, else, where nothing else is known, twice the
    largest one of the sweep.  Raises ConfigError for a file that cannot be read or is of no report
    day.
    """
    plan, scene, report_days = spaces.plan, spaces.scene, spaces.schedule.report_days
    if plan.reference:
        return TotalReference("file", dict(_of_user(path, report_days) for path in plan.reference))
    if plan.finer:
        return TotalReference("finer", finer=plan.finer)
    if scene.exact is not None:
        return TotalReference("exact")
    if files := _shipped(scene, report_days):
        return TotalReference("file", files)
    kind = "finer" if plan.finer is None else "none"
    return TotalReference(kind, finer=2 * max(spaces.ne))


def _of_user(path: Path, report_days: tuple[float, ...]) -> tuple[float, Path]:
    time = Reference(path).time
    if time is None:
        return report_days[-1], path
    near = [day for day in report_days if abs(day * DAY - time) < 1.0]
    if not near:
        days = ", ".join(f"{day:g}" for day in report_days)
        raise ConfigError(
            f"reference: {path} is of day {time / DAY:g}, errors are taken at day {days}: add it to"
            " report-days"
        )
    return near[0], path


def _shipped(scene: Scene, report_days: tuple[float, ...]) -> dict[float, Path]:
    """Files of the package by report day, where the scene is just that of the files."""
    files: dict[float, Path] = {}
    for label, (name, settings) in SHIPPED.items():
        if scene.name != name:
            continue
        original = make_scene(make_config({"scene": name, "settings": settings}))
        if (original.effects, original.parameters, original.planet) == (
            scene.effects, scene.parameters, scene.planet
        ):  # fmt: skip
            found = {day: shipped_reference(label, day) for day in report_days}
            files |= {day: path for day, path in found.items() if path is not None}
    return files


LONGEST = 2.8
"""Step, in gravity limits, that stands for the stability limit of an implicit converged run."""
FINER = ("rk4", 0.85)
"""Stepper of the finer run, and its step as a part of its stability limit."""


class Evaluator:
    """Takes the errors of runs; what they are taken against is made when it is first asked for.

    Runs made for it have no time limit.  Their fields are kept in the folder and read again; where
    one fails there is a row that tells why, and no fields.
    """

    def __init__(
        self, spaces: Discretisations, total: TotalReference, runner: Runner, folder: Path
    ) -> None:
        self._spaces, self._total, self._runner, self._folder = spaces, total, runner, folder
        self._plan, self._schedule = spaces.plan, spaces.schedule
        self._slow = spaces.scene.sheds_waves if self._plan.slow is None else self._plan.slow
        self._converged: dict[tuple[int, int], History] = {}
        self._right: dict[tuple[str, float], OnGrid | Fields | None] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """What errors are taken against: part of the identity of a run whose errors are taken."""
        time = f"{self._plan.converged_stepper} at {self._plan.converged_part:g} of its limit"
        return (time, self._total.name, *(["slow flow"] if self._slow else []))

    def __call__(self, space: Discretisation, history: History) -> list[Errors]:
        """Errors of all kinds of the fields at report days."""
        converged = self.converged(space)
        days = [day for day in history if day in converged]
        kinds = {"time": flow_errors} | ({"slow": slow_errors} if self._slow else {})
        found = self._total_errors(space, history)
        for kind, errors in kinds.items():
            of_days = {day: errors(space.model, history[day], converged[day]) for day in days}
            found += Errors.of(kind, of_days)
        return found

    # --- against the run converged in time

    def converged(self, space: Discretisation) -> History:
        """Fields at report days of a run converged in time, on the same mesh in float64.

        A run of twice the step tells by Richardson's rule how large its own error in time is; the
        rows of both hold these errors, and the total ones.
        """
        key = (space.mesh.ne, space.mesh.np)
        if key not in self._converged:
            integrator = self._integrator(self._spaces.at(*key), self._plan.converged_stepper)
            limit = min(integrator.stable_dt, LONGEST * integrator.space.gravity_limit)
            twice = self._schedule.steps(2.0 * self._plan.converged_part * limit)
            once = replace(twice, dt=0.5 * twice.dt, steps=2 * twice.steps,
                           frame_steps=2 * twice.frame_steps)  # fmt: skip
            coarse, fine = (integrator.planned(steps, "converged") for steps in (twice, once))
            if self._kept(fine) is None:
                self._compare(coarse, fine)
            self._converged[key] = self._kept(fine) or {}
        return self._converged[key]

    def _compare(self, coarse: RunSpec, fine: RunSpec) -> None:
        """Make both runs and keep what each says of the other."""
        results = {spec: self._runner.result(spec) for spec in (coarse, fine)}
        ours, right = results[coarse].snapshots, results[fine].snapshots
        apart = {
            day: flow_errors(fine.space.model, ours[day], right[day])
            for day in self._schedule.report_days
            if day in ours and day in right
        }
        integrator = fine.integrator
        gain = 2.0 ** integrator.kind.order_in(fine.space.model, **integrator.options)
        for spec, share in ((coarse, gain / (gain - 1.0)), (fine, 1.0 / (gain - 1.0))):
            errors = Errors.of("time", apart, share)
            snapshots = results[spec].snapshots
            self._keep(spec, results[spec], errors + self._total_errors(spec.space, snapshots))

    # --- in total

    def _total_errors(self, space: Discretisation, history: History) -> list[Errors]:
        """The total errors alone."""
        norms = {day: self._total_norms(space, day, fields) for day, fields in history.items()}
        return Errors.of("total", norms)

    def _total_norms(self, space: Discretisation, day: float, fields: Fields) -> Norms:
        key = (space.identity, day)
        if key not in self._right:
            self._right[key] = self._reference(space, day)
        right = self._right[key]
        if isinstance(right, OnGrid):
            return right.errors(fields | {"b": space.start["b"]}, space.scene.error_field)
        return {} if right is None else flow_errors(space.model, fields, right)

    def _reference(self, space: Discretisation, day: float) -> OnGrid | Fields | None:
        """What a file holds, the exact solution at the nodes, or that of the finer run there."""
        if day in self._total.files:
            return OnGrid(Reference(self._total.files[day]), space.mesh)
        if self._total.kind == "exact":
            return _exact(space, day)
        if self._total.kind != "finer":
            return None
        fine = self._spaces.at(self._total.finer, max(self._spaces.np))
        history = self._finer(fine)
        return at_nodes(fine.mesh, history[day], space.mesh) if day in history else None

    def _finer(self, space: Discretisation) -> History:
        """Fields at report days of a run on a finer mesh."""
        stepper, part = FINER
        integrator = self._integrator(space, stepper)
        spec = integrator.run(part * integrator.stable_dt, "converged")
        if self._kept(spec) is None:
            self._keep(spec, self._runner.result(spec), [])
        return self._kept(spec) or {}

    # --- runs made to be compared with

    def _integrator(self, space: Discretisation, stepper: str) -> Integrator:
        config = space.config.model_copy(update={"stepper": stepper})
        return Integrator(space, config, self._schedule, ("reference run", self._total.name))

    def _file(self, spec: RunSpec) -> Path:
        return self._folder / f"{spec.key}.nc"

    def _kept(self, spec: RunSpec) -> History | None:
        """Its fields, none of a run that failed; None where it is yet to be made."""
        known = self._runner.known(spec)
        if known is None:
            return None
        return _load(self._file(spec)) if known.status == "completed" else {}

    def _keep(self, spec: RunSpec, result: Result, errors: list[Errors]) -> None:
        """Fields first: what there is a record of has been written."""
        if result.status == "completed":
            _save(self._file(spec), result.snapshots, spec.label)
        if self._runner.known(spec) is None:
            self._runner.keep(spec, result, errors)


def _save(path: Path, history: History, label: str) -> None:
    """Write u, v, h and vorticity (N,) at report days to a file; RunFailed if the disk refuses."""
    import xarray as xr

    fields = {
        name: (("report_day", "node"), np.stack([of_day[name] for of_day in history.values()]))
        for name in KEPT
    }
    write_whole(path, as_netcdf(xr.Dataset(fields, {"report_day": [*history]}, {"title": label})))


def _load(path: Path) -> History | None:
    """What `_save` wrote; None where there is no such file or it cannot be read."""
    import xarray as xr

    try:
        found = xr.load_dataset(path, engine="netcdf4")
        fields = {name: found[name].values for name in KEPT}
    except (OSError, LookupError):
        return None
    days = found["report_day"].values.tolist()
    return {day: {name: fields[name][n] for name in KEPT} for n, day in enumerate(days)}


def _exact(space: Discretisation, day: float) -> Fields:
    """The exact solution; its vorticity is that of the exact wind, differentiated on the mesh."""
    fields = exact_fields(space.model, day * DAY)
    return fields | {"vorticity": vorticity(space.mesh, fields["u"], fields["v"])}
