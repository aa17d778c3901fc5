"""What errors are taken against: exact solutions, files, and runs made for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from swe_sphere.durable import write_whole
from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
from swe_sphere.fingerprints import code_fingerprint, file_fingerprint
from swe_sphere.planet import DAY
from swe_sphere.simulation.config import make_config
from swe_sphere.simulation.scene_files import scene_sources
from swe_sphere.simulation.setup import make_scene
from swe_sphere.simulation.time_plan import TimePlan
from swe_sphere.studies.errors import Norms, field_errors
from swe_sphere.studies.store import as_netcdf
from swe_sphere.studies.sweep.discretisation import Discretisation, History
from swe_sphere.studies.sweep.record import Errors
from swe_sphere.studies.sweep.runner import KEPT, Result, Runner, TakeErrors
from swe_sphere.studies.sweep.runspec import Integrator, RunSpec, Schedule, users_fingerprint
from swe_sphere.studies.sweep.sweep_plan import SweepPlan

if TYPE_CHECKING:
    pass

__all__ = ["ReferenceRuns", "TotalReference", "choose_reference", "sweep_sources"]


SHIPPED: dict[str, tuple[str, tuple[str, ...]]] = {
    "williamson5": ("williamson5", ()),
    "williamson6": ("williamson6", ()),
    "galewsky": ("galewsky", ()),
    "galewsky_viscous": ("galewsky", ("viscosity.nu=1e5",)),
}
"""Solutions that come with the package: the scene and the settings of each."""

CODE = "the code of swe_sphere"


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


def sweep_sources(
    plan: SweepPlan, scene: Scene, own: Scene | None, total: TotalReference
) -> dict[str, str]:
    """Fingerprints of all that every row of a sweep is made of but its settings, by what it is.

    own: the scene, where it was given as an object.
    """
    found = {CODE: code_fingerprint(), **scene_sources(plan.scene, scene), **total.sources}
    return found if own is None else found | {"the scene": users_fingerprint(own.initial)}


def choose_reference(
    scene: Scene,
    report_days: tuple[float, ...],
    references: tuple[Path, ...],
    finer: int | None,
    largest_ne: int,
) -> TotalReference:
    """Files of the user, else the exact solution, else files of the package, else a finer run.

    references: lat-lon files of the user; finer: ne of a finer run, 0 for none, None: where nothing
    else is known, of twice the largest ne of the sweep.  Raises ConfigError for a file that cannot
    be read or is of no report day.
    """
    if references:
        return TotalReference("file", dict(_of_user(path, report_days) for path in references))
    if finer:
        return TotalReference("finer", finer=finer)
    if scene.exact is not None:
        return TotalReference("exact")
    files = _shipped(scene, report_days)
    if files:
        return TotalReference("file", files)
    return TotalReference("none") if finer == 0 else TotalReference("finer", finer=2 * largest_ne)


def _of_user(path: Path, report_days: tuple[float, ...]) -> tuple[float, Path]:
    from swe_sphere.io.reference_solution import Reference

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
    from swe_sphere.io.reference_solution import shipped_reference

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


class ReferenceRuns:
    """Makes such runs, keeps their fields in the folder, and reads them again.

    They have no time limit; where one fails there is a row that tells why, and no fields here.
    """

    def __init__(self, runner: Runner, folder: Path, schedule: Schedule, total: str) -> None:
        """total: name of what the total errors are taken against."""
        self._runner, self._folder, self._schedule = runner, folder, schedule
        self._references = ("reference run", total)

    def converged(
        self, space: Discretisation, stepper: str, part: float, total: TakeErrors
    ) -> History:
        """A run converged in time: its step is that part of the stability limit.

        A run of twice the step tells by Richardson's rule how large its own error in time is; the
        rows of both hold these errors, and those that `total` finds.
        """
        integrator = self._integrator(space, stepper)
        limit = min(integrator.stable_dt, LONGEST * space.gravity_limit)
        twice = self._schedule.steps(2.0 * part * limit)
        coarse, fine = (integrator.planned(x, "converged") for x in (twice, _halved(twice)))
        if self._kept(fine) is None:
            self._compare(coarse, fine, integrator.kind.order, total)
        return self._kept(fine) or {}

    def finer(self, space: Discretisation) -> History:
        """A run on a finer mesh, for the total error."""
        stepper, part = FINER
        integrator = self._integrator(space, stepper)
        spec = integrator.run(part * integrator.stable_dt, "converged")
        if self._kept(spec) is None:
            self._keep(spec, self._runner.result(spec), [])
        return self._kept(spec) or {}

    def _integrator(self, space: Discretisation, stepper: str) -> Integrator:
        config = space.config.model_copy(update={"stepper": stepper})
        return Integrator(space, config, self._schedule, self._references)

    def _compare(self, coarse: RunSpec, fine: RunSpec, order: int, total: TakeErrors) -> None:
        """Make both runs and keep what each says of the other."""
        results = {spec: self._runner.result(spec) for spec in (coarse, fine)}
        ours, right = results[coarse].snapshots, results[fine].snapshots
        apart = {
            day: field_errors(fine.space, ours[day], right[day])
            for day in self._schedule.report_days
            if day in ours and day in right
        }
        shares = {coarse: 1.0, fine: 1.0 / 2.0**order}
        for spec, result in results.items():
            share = shares[spec] / (1.0 - 2.0**-order)
            errors = Errors.of("time", {day: _part(share, of) for day, of in apart.items()})
            self._keep(spec, result, errors + total(spec.space, result.snapshots))

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


def _halved(steps: TimePlan) -> TimePlan:
    return replace(
        steps, dt=0.5 * steps.dt, steps=2 * steps.steps, frame_steps=2 * steps.frame_steps
    )


def _part(share: float, errors: Norms) -> Norms:
    return {name: {n: share * x for n, x in norms.items()} for name, norms in errors.items()}
