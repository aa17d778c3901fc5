"""Ensembles: the same run from several seeds of its scene, and how far apart they drift."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.files.durable import clear_errors, write_whole
from swe_sphere.files.fingerprints import code_fingerprint
from swe_sphere.io.layout import MESH_ATTRIBUTES
from swe_sphere.io.norms import area_mean
from swe_sphere.io.runfile import TOLERANCE, RunFile, table_in
from swe_sphere.io.scalar_fields import check_field, describe
from swe_sphere.pictures.panels import Panel, draw_panel
from swe_sphere.pictures.plot import DOTS_PER_INCH, new_figure
from swe_sphere.planet import DAY
from swe_sphere.settings.values import SCENE, Setting
from swe_sphere.simulation.build import make_scene
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.loop import Interrupted
from swe_sphere.simulation.restart import method_sources, scene_sources
from swe_sphere.simulation.simulation import run

MOST = 1000
"""Members there may be."""


@dataclass(frozen=True)
class Spread:
    """Root mean square over the globe of the standard deviation of the members, of a field."""

    field: str
    times: Array
    """(T,) [s]."""
    values: Array
    """(T,) in the units of the field."""

    @property
    def rates(self) -> Array:
        """Growth (T,) since the time before [day-1]: Δ ln spread / Δt; NaN for the first."""
        with np.errstate(divide="ignore", invalid="ignore"):
            found: Array = np.diff(np.log(self.values)) / np.diff(self.times / DAY)
        return np.append(np.nan, found)


def run_members(
    config: RunConfig, seeds: Sequence[int], folder: Path, tell: Callable[[str], None]
) -> list[Path]:
    """Run the scene with `scene.seed` of each of the seeds; the files, SCENE_seedK.nc in a folder.

    A member of the same configuration that is there is kept where it is finished, and else made
    again.  tell: is given a line for each member.

    Raises ConfigError for fewer than two seeds, for a scene that has no seed, or if a run cannot be
    made as asked for; RunFailed if one does not come to its end, Interrupted if the user stops it.
    """
    if len(seeds) > MOST or not 2 <= len(set(seeds)) == len(seeds):
        few = ",".join(map(str, seeds[:8])) or "none"
        raise ConfigError(f"seeds: give 2 to {MOST} different ones, not {few}")
    with clear_errors(f"cannot write to {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
    return [_member(config, seed, folder, tell) for seed in seeds]


def _member(config: RunConfig, seed: int, folder: Path, tell: Callable[[str], None]) -> Path:
    out = folder / f"{Path(config.scene).stem}_seed{seed}.nc"
    settings = (*config.settings, Setting(SCENE, "seed", seed))
    asked = config.model_copy(update={"settings": settings, "out": out})
    there = RunFile(out).attributes if out.exists() and not config.overwrite else None
    if there is not None and _is_of(out, there, asked):
        if there.get("completed"):
            tell(f"seed {seed}: kept, {out}")
            return out
        asked = asked.model_copy(update={"overwrite": True})  # with frames at the same times
    summary = run(asked)
    if summary.status == "interrupted":
        raise Interrupted(
            f"seed {seed}: {summary.reason}; the same command goes on with the others"
        )
    if not summary.completed:
        raise RunFailed(f"seed {seed}: {summary.reason}")
    tell(f"seed {seed}: {summary['wall_seconds']:.3g} s, {out}")
    return out


def _is_of(file: Path, found: Mapping[str, object], config: RunConfig) -> bool:
    """Whether a file with these attributes is of a run of the configuration.

    Raises ConfigError if the code, or the user's files that the run is made of, are not what they
    were.
    """
    stored, asked = table_in(str(found.get("configuration"))), config.model_dump(mode="json")
    apart = {"overwrite": False, "out": None}
    if stored | apart != asked | apart:
        return False
    sources = scene_sources(config.scene, make_scene(config)) | method_sources(config)
    if found.get("code") != code_fingerprint() or table_in(str(found.get("sources"))) != sources:
        raise ConfigError(
            f"{file} was made by other code, or from files that have been edited since: make the"
            " members again (--overwrite), or choose another folder"
        )
    return True


def spread(files: Sequence[Path], field: str = "vorticity") -> Spread:
    """The spread of the members in the files, at the times of their frames.

    Raises ConfigError if the files are not on one mesh, lack the field or have other times, or if
    they do not differ in the field.
    """
    runs = [RunFile(path) for path in files]
    field = check_field(field, runs[0].about)
    times, mesh = runs[0].times, runs[0].mesh
    for other in runs[1:]:
        same = all(other.attributes[name] == runs[0].attributes[name] for name in MESH_ATTRIBUTES)
        alike = other.times.shape == times.shape and np.ptp(other.times - times) < TOLERANCE
        if not (same and alike):
            raise ConfigError(f"{other.path} has another mesh or other times than {runs[0].path}")
    found = [
        np.var([run.values(field, time) for run in runs], axis=0, ddof=1) for time in times
    ]  # fmt: skip
    if not any(each.any() for each in found):
        raise ConfigError(f"field {field}: it is the same in all members")
    return Spread(field, times, np.sqrt([area_mean(mesh.area, each) for each in found]))


def write_spread(found: Spread, folder: Path) -> list[Path]:
    """The spread as a table, spread_FIELD.csv, and as a picture beside it."""
    kind, text, picture = describe(found.field), io.StringIO(), io.BytesIO()
    rows = csv.writer(text)
    rows.writerow(["day", f"spread [{kind.plain_units}]", "growth [day-1]"])
    rows.writerows(zip(found.times / DAY, found.values, found.rates, strict=True))
    figure = new_figure()
    figure.set_size_inches(6.4, 4.0)
    title = f"spread of {kind.title} [{kind.units}]"
    draw_panel(figure.subplots(), Panel(title, found.times, {"all members": found.values}), None)
    figure.savefig(picture, format="png", dpi=DOTS_PER_INCH)
    table, drawn = (folder / f"spread_{found.field}{ending}" for ending in (".csv", ".png"))
    write_whole(table, text.getvalue())
    write_whole(drawn, picture.getvalue())
    return [table, drawn]
