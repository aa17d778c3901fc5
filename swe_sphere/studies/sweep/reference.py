"""What the total errors of a sweep are taken against: files, the exact solution, a finer run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
from swe_sphere.files.fingerprints import file_fingerprint
from swe_sphere.io.reference_solution import Reference, shipped_reference
from swe_sphere.planet import DAY
from swe_sphere.simulation.build import make_scene
from swe_sphere.simulation.config import make_config
from swe_sphere.studies.sweep.sweep_plan import SweepPlan

SHIPPED: dict[str, tuple[str, tuple[str, ...]]] = {
    "williamson5": ("williamson5", ()),
    "williamson6": ("williamson6", ()),
    "galewsky": ("galewsky", ()),
    "galewsky_viscous": ("galewsky", ("viscosity.nu=1e5",)),
}
"""Solutions that come with the package: the scene and the settings of each."""


@dataclass(frozen=True)
class TotalReference:
    """What the total error is taken against, before anything is computed."""

    kind: str
    """exact, file, finer or none."""
    files: Mapping[float, Path] = field(default_factory=dict)
    """Paths of reference solutions, by report day."""
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


def choose_reference(
    plan: SweepPlan, scene: Scene, report_days: Sequence[float], ne: Sequence[int]
) -> TotalReference:
    """Files of the user, else the exact solution, else files of the package, else a finer run.

    The finer run has the ne that the plan says, else, where nothing else is known, twice the
    largest one of the sweep.  Raises ConfigError for a file that cannot be read or is of no report
    day.
    """
    if plan.reference:
        return TotalReference("file", dict(_of_user(path, report_days) for path in plan.reference))
    if plan.finer:
        return TotalReference("finer", finer=plan.finer)
    if scene.exact is not None:
        return TotalReference("exact")
    if files := _shipped(scene, report_days):
        return TotalReference("file", files)
    return TotalReference("finer" if plan.finer is None else "none", finer=2 * max(ne))


def _of_user(path: Path, report_days: Sequence[float]) -> tuple[float, Path]:
    time = Reference(path).nearest(None)
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


def _shipped(scene: Scene, report_days: Sequence[float]) -> dict[float, Path]:
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
