"""`swe-sphere list`, `plot`, `animate`, `compare` and `regrid`: work on files of runs."""

import json
import re
from collections.abc import Iterable
from pathlib import Path
from shutil import get_terminal_size
from textwrap import shorten
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer

from swe_sphere.cli.options import AsJson, Field, flag, given, option, with_flags
from swe_sphere.errors import ConfigError
from swe_sphere.files.user_file import check_trusted
from swe_sphere.pictures.look import Look
from swe_sphere.planet import DAY
from swe_sphere.settings.registry import first_line
from swe_sphere.settings.values import names_in, validate
from swe_sphere.simulation.summary import finite

if TYPE_CHECKING:
    from swe_sphere.io.reference_solution import Exact
    from swe_sphere.io.runfile import Source

File = Annotated[Path, typer.Argument(help="File of a run.")]


def list_all() -> None:
    """List scenes, steppers by family, and effects, one line each."""
    from swe_sphere.equations.effects import EFFECTS
    from swe_sphere.steppers import get_stepper, list_steppers
    from swe_sphere.steppers.stepper import Family
    from swe_sphere.testcases import list_scenes

    groups, steppers = {"Scenes": list_scenes()}, list_steppers()
    for family in get_args(Family):
        of = {name: text for name, text in steppers.items() if get_stepper(name).family == family}
        groups[f"Steppers, {family}"] = of
    groups["Effects"] = {name: first_line(effect) for name, effect in EFFECTS.items()}
    for title, lines in groups.items():
        width = max(map(len, lines))
        left = max(80, get_terminal_size().columns) - width - 4
        typer.echo(f"{title}:")
        for name, text in lines.items():
            short = shorten(text, left, placeholder=" …", break_on_hyphens=False)
            typer.echo(f"  {name:{width}}  {short}")


@with_flags(Look)
def plot(
    file: File,
    field: Field = None,
    time: float | None = option("DAYS", "Time of the frame (the last)."),
    out: Path | None = option("FILE.png", "The picture (beside the file: FILE_FIELD[_dayN].png)."),
    compare: str | None = option("FILE.nc|exact", "Draw the difference from this solution."),
    trust: list[Path] | None = option("FILE", "Code of the file's scene, for exact; repeatable."),
    overwrite: bool = flag("overwrite", "Replace an existing picture."),
    **look: Any,
) -> None:
    """Draw a field of a run, or of a regridded file, on the globe."""
    from swe_sphere.pictures.plot import plot_file

    seconds = None if time is None else time * DAY
    against = None if compare is None else _against(file, compare, trust or ())
    chosen = validate(Look, given(look, Look))
    typer.echo(plot_file(file, field, seconds, out, chosen, against, overwrite))


@with_flags(Look, without=["panel"])
def animate(
    file: File,
    field: Field = None,
    out: Path | None = option("FILE.mp4|FILE.gif", "The film (beside: FILE_FIELD.mp4)."),
    rate: float = option("N", "Frames a second.", 8.0),
    overwrite: bool = flag("overwrite", "Replace an existing film."),
    **look: Any,
) -> None:
    """Make a film of all frames of a run."""
    from swe_sphere.pictures.plot import animate_file

    typer.echo(animate_file(file, field, out, validate(Look, given(look, Look)), rate, overwrite))


def _against(file: Path, other: str, trust: Iterable[Path]) -> "Source | Exact":
    """Return the source to compare with: a file, or the exact solution of the file's scene."""
    from swe_sphere.io.reference_solution import Exact, open_source

    if other != "exact":
        return open_source(other)
    from swe_sphere.io.runfile import RunFile, table_in
    from swe_sphere.simulation.build import make_scene
    from swe_sphere.simulation.config import make_config
    from swe_sphere.simulation.restart import scene_identity

    run = RunFile(file)
    settings = table_in(str(run.attributes.get("configuration")))
    if "scene" not in settings:
        raise ConfigError(f"{file} does not state its scene: compare with another file")
    if origin := run.attributes.get("origin"):
        raise ConfigError(
            f"{file} began from {origin} and has no exact solution: compare with another file"
        )
    check_trusted(settings["scene"], file, trust)
    scene, theirs = make_scene(make_config(settings)), run.attributes.get("identity")
    ours, known = json.loads(json.dumps(scene_identity(scene))), table_in(str(theirs))
    if any(value != known.get(name, value) for name, value in ours.items()):
        raise ConfigError(f"{file} is of a scene made in Python: compare with another file")
    return Exact(scene, run.mesh)


def compare(
    a: Annotated[Path, typer.Argument(help="File whose errors are computed.")],
    b: Annotated[Path, typer.Argument(help="Reference file, on any grid.")],
    field: Field = None,
    time: float | None = option("DAYS", "Time to compare (default: the last that both contain)."),
    across_scenes: bool = flag("across-scenes", "Allow runs of different scenes."),
    as_json: AsJson = False,
) -> None:
    """Print l1, l2 and linf of A against B."""
    from swe_sphere.io.reference_solution import compare as compare_files

    result = compare_files(a, b, field, None if time is None else time * DAY, across_scenes)
    if as_json:
        typer.echo(json.dumps(finite(result)))
        return
    when = "" if result["time"] is None else f" at day {float(result['time']) / DAY:g}"
    typer.echo(f"{result['field']}{when}")
    for norm in ("l1", "l2", "linf"):
        typer.echo(f"  {norm:5} {result[norm]:.6e}")


def regrid(
    file: File,
    grid: str = option("latlon:ROWSxCOLUMNS|gaussian:N", "Grid (N: 2N x 4N).", "latlon:181x360"),
    out: Path | None = option("FILE.nc|FILE.zarr", "The result (beside: FILE_GRID.nc)."),
    fields: str | None = option("A,B,...", "Variables to write (default: all)."),
    overwrite: bool = flag("overwrite", "Replace an existing file."),
) -> None:
    """Interpolate the frames of a run to a grid of latitudes and longitudes."""
    from swe_sphere.analysis.regrid import regrid_file

    place = out or file.parent / f"{file.stem}_{re.sub(r'[^a-z0-9]', '', grid)}.nc"
    typer.echo(regrid_file(file, grid, place, names_in(fields), overwrite))
