"""Which truth the total error of a sweep is taken against."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path

from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
from swe_sphere.fingerprints import file_fingerprint
from swe_sphere.planet import DAY
from swe_sphere.simulation.config import make_config
from swe_sphere.simulation.setup import make_scene

__all__ = ["SHEDDING", "TotalTruth", "choose_truth"]

SHEDDING = ("williamson5", "williamson6")
"""Scenes whose start sheds gravity waves, so that depth alone does not rank steppers."""

VISCOUS = ("viscosity.nu=1e5",)

SHIPPED: tuple[tuple[str, tuple[str, ...], float, str], ...] = (
    ("williamson5", (), 5.0, "williamson5_day5.nc"),
    ("williamson5", (), 15.0, "williamson5_day15.nc"),
    ("williamson6", (), 7.0, "williamson6_day7.nc"),
    ("williamson6", (), 14.0, "williamson6_day14.nc"),
    ("galewsky", (), 4.0, "galewsky_day4.nc"),
    ("galewsky", (), 6.0, "galewsky_day6.nc"),
    ("galewsky", VISCOUS, 6.0, "galewsky_viscous_day6.nc"),
)
"""Independent solutions that come with the package: scene, its settings, day, file."""


@dataclass(frozen=True)
class TotalTruth:
    """What the total error is taken against, before anything is computed."""

    kind: str
    """exact, reference, finer or none."""
    files: Mapping[float, Path]
    """Of references, by report day."""
    finer: int = 0
    """ne of the finer run."""

    @cached_property
    def sources(self) -> dict[str, str]:
        """Fingerprints of the files, by what they are."""
        return {
            f"the reference of day {day:g}": file_fingerprint(path)
            for day, path in self.files.items()
        }

    @property
    def name(self) -> str:
        """The truth in words, the contents of files included as a fingerprint."""
        if self.kind == "reference":
            return str(self.sources)
        return f"finer run, ne {self.finer}" if self.kind == "finer" else self.kind


def choose_truth(
    scene: Scene,
    report_days: tuple[float, ...],
    references: tuple[Path, ...],
    finer: int | None,
    largest_ne: int,
) -> TotalTruth:
    """The truth: files given, then the exact solution, then files shipped, then a finer run.

    references: lat-lon files of the user; finer: ne of a finer run, 0 for none, None: where nothing
    else is known, of twice the largest ne of the sweep.  Raises ConfigError for a file that cannot
    be read or is of no report day.
    """
    if references:
        return TotalTruth("reference", _by_day(references, report_days))
    if finer:
        return TotalTruth("finer", {}, finer)
    if scene.exact is not None:
        return TotalTruth("exact", {})
    files = _shipped(scene, report_days)
    if files:
        return TotalTruth("reference", files)
    return TotalTruth("none", {}) if finer == 0 else TotalTruth("finer", {}, 2 * largest_ne)


def _by_day(references: tuple[Path, ...], report_days: tuple[float, ...]) -> dict[float, Path]:
    from swe_sphere.io.reference_solution import Reference

    files = {}
    for path in references:
        time = Reference(path).time
        day = report_days[-1] if time is None else _nearest(time / DAY, report_days)
        if day is None:
            days = ", ".join(f"{day:g}" for day in report_days)
            raise ConfigError(
                f"reference: {path} is of day {(time or 0.0) / DAY:g}, errors are taken at day"
                f" {days}: add it to report-days"
            )
        files[day] = path
    return files


def _nearest(day: float, report_days: tuple[float, ...]) -> float | None:
    return next((known for known in report_days if abs(known - day) * DAY < 1.0), None)


def _shipped(scene: Scene, report_days: tuple[float, ...]) -> dict[float, Path]:
    files = {}
    for name, settings, day, file in SHIPPED:
        path = Path(str(resources.files("swe_sphere"))) / "data" / file
        if scene.name != name or day not in report_days or not path.is_file():
            continue
        original = make_scene(make_config({"scene": name, "settings": settings}))
        same = (original.effects, original.parameters, original.planet)
        if same == (scene.effects, scene.parameters, scene.planet):
            files[day] = path
    return files
