"""Ensembles: the same run from several seeds of its scene, and the growth of the spread."""

import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError, Interrupted, RunFailed
from swe_sphere.files.durable import translate_errors, write_whole
from swe_sphere.files.fingerprints import code_fingerprint
from swe_sphere.io.checkpoint import checkpoint_path
from swe_sphere.io.integrals import area_mean
from swe_sphere.io.runfile import TIME_TOLERANCE, RunFile, table_in
from swe_sphere.io.scalar_fields import check_field, describe
from swe_sphere.pictures.panels import ROUND, Panel, draw_panel
from swe_sphere.pictures.plot import DOTS_PER_INCH, new_figure
from swe_sphere.planet import DAY
from swe_sphere.settings.values import SCENE, Setting
from swe_sphere.simulation.build import make_scene
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.restart import run_sources
from swe_sphere.simulation.simulation import run_scene

MARKS = ("day,spread [", "made by swe-sphere ensemble")
"""Texts by which the table and the picture of a spread are recognised."""
FREE = ("overwrite", "out", "days", "time_limit", "restart", "quiet", "as_json", "live", "plot")
"""Fields of the configuration that may differ between a member and its existing file."""


def run_members(
    config: RunConfig, seeds: Sequence[int], folder: Path, tell: Callable[[str], None]
) -> list[Path]:
    """Run a scene with `scene.seed` of each seed; return the files SCENE_seedK.nc in a folder.

    A finished member of the same configuration is kept; an unfinished or shorter one is resumed
    from its checkpoint, or run again if it has none.

    tell: called with a line for each member. Raises ConfigError for fewer than two seeds, a scene
    without a seed, a seed among the settings, or a run that cannot be made; RunFailed if a run does
    not reach its end; and Interrupted if the user stops it.
    """
    if "seed" in config.settings_of(SCENE):
        raise ConfigError("scene.seed differs between members: set it with seeds (--seeds) only")
    if len(seeds) > 1000 or not 2 <= len(set(seeds)) == len(seeds):
        few = ",".join(map(str, seeds[:8])) or "none"
        raise ConfigError(f"seeds: give 2 to 1000 different numbers, got {few}")
    with translate_errors(f"cannot write to {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
    return [_member(config, seed, folder, tell) for seed in seeds]


def _member(config: RunConfig, seed: int, folder: Path, tell: Callable[[str], None]) -> Path:
    out = folder / f"{Path(config.scene).stem}_seed{seed}.nc"
    settings = (*config.settings, Setting(SCENE, "seed", seed))
    member = config.model_copy(update={"settings": settings, "out": out})
    if out.exists() and not config.overwrite:
        found, apart = RunFile(out).attributes, dict.fromkeys(FREE)
        stored, scene = table_in(str(found.get("configuration"))), make_scene(member)
        days, before = (scene.days if x is None else x for x in (member.days, stored.get("days")))
        same = stored | apart == member.model_dump(mode="json") | apart
        if same and isinstance(before, int | float) and before <= days:
            _check_sources(found, member, scene)
            if found.get("completed") and before == days:
                tell(f"seed {seed}: kept, {out}")
                return out
            begun = checkpoint_path(out).exists()
            resumed = {"restart": out, "days": days} if begun else {"overwrite": True}
            member = member.model_copy(update=resumed)
    summary = run_scene(member, more=True)
    if summary.status == "interrupted":
        raise Interrupted(f"seed {seed}: {summary.reason}; the same command runs the others")
    if not summary.completed:
        hint = "; the same command resumes it" if summary.status == "timed-out" else ""
        raise RunFailed(f"seed {seed}: {summary.reason}{hint}")
    tell(f"seed {seed}: {summary['wall_seconds']:.3g} s, {out}")
    return out


def _check_sources(found: Mapping[str, object], config: RunConfig, scene: Scene) -> None:
    """Raise ConfigError if the code or the user's files of a run have changed since."""
    sources = run_sources(config, scene)
    if found.get("code") != code_fingerprint() or table_in(str(found.get("sources"))) != sources:
        raise ConfigError(
            f"{config.out} was made by other code, or from files that have been edited since: make"
            " the members again (--overwrite), or choose another folder"
        )


def spread(files: Sequence[Path], field: str = "vorticity") -> pd.DataFrame:
    """Return the spread of the members in a field, at the times that all files contain.

    The columns are `day`; `spread`, the root mean square over the globe of the standard deviation
    of the members, in the units of the field; and `growth`, Δ ln spread / Δt since the frame before
    [day-1], NaN for the first frame and where the spread is zero.

    Raises ConfigError if the files differ in mesh, have fewer than two times in common (or one, if
    the first file has one), lack the field or are equal in it.
    """
    runs = [RunFile(path) for path in files]
    field = check_field(field, runs[0].about)
    times, mesh = runs[0].times, runs[0].mesh
    for other in runs[1:]:  # interrupted members have further frames
        same = np.array_equal(other.mesh.xyz, mesh.xyz)
        times = times[[bool(np.any(np.abs(other.times - t) < TIME_TOLERANCE)) for t in times]]
        if times.size < min(2, runs[0].times.size) or not same:
            raise ConfigError(f"{other.path} has another mesh or other times than {runs[0].path}")
    frames = (np.stack([run.values(field, time) for run in runs]) for time in times)
    found = [np.var(each - each[0], axis=0, ddof=1) for each in frames]  # of equal values exactly 0
    if not any(each.any() for each in found):
        raise ConfigError(f"field {field}: it is the same in all members")
    table = pd.DataFrame({"day": times / DAY})
    table.attrs = dict(runs[0].about.get(field, {}))
    table["spread"] = np.sqrt([area_mean(mesh.area, each) for each in found])
    positive = table["spread"].where(table["spread"] > 0.0)
    table["growth"] = np.log(positive).diff() / table["day"].diff()
    return table


def spread_files(field: str, folder: Path) -> list[Path]:
    """Return the paths of the table and of the picture that `write_spread` writes."""
    return [folder / f"spread_{field}{ending}" for ending in (".csv", ".png")]


def write_spread(table: pd.DataFrame, field: str, folder: Path) -> list[Path]:
    """Write the spread of a field as spread_FIELD.csv and as a picture beside it; return both."""
    paths, kind, picture = spread_files(field, folder), describe(field, table.attrs), io.BytesIO()
    heads = ["day", f"spread [{kind.plain_units}]", "growth [day-1]"]
    write_whole(paths[0], table.to_csv(index=False, header=heads, na_rep="nan"))
    figure = new_figure()
    figure.set_size_inches(6.4, 4.0)
    title = f"spread of {kind.title} [{kind.units}]"
    positive = table["spread"] > 0.0  # zeros are left out of the logarithmic axis
    values = table["spread"].where(positive, np.nan if positive.any() else ROUND).to_numpy()
    panel = Panel(title, DAY * table["day"].to_numpy(), {"all members": values})
    draw_panel(figure.subplots(), panel, None)
    figure.savefig(picture, format="png", dpi=DOTS_PER_INCH, metadata={"Source": MARKS[1]})
    write_whole(paths[1], picture.getvalue())
    return paths
