"""Files of independent solutions: what the total errors of a sweep are taken against."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
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


def reference_files(
    plan: SweepPlan, scene: Scene, report_days: Sequence[float]
) -> dict[float, Path]:
    """Files by report day: those of the user, else of scenes without exact solution the package's.

    Raises ConfigError for a file that cannot be read or is of no report day.
    """
    if plan.reference:
        return dict(_of_user(path, report_days) for path in plan.reference)
    return {} if scene.exact is not None else _shipped(scene, report_days)


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
