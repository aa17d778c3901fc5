"""`swe-sphere plot` and `animate`: pictures and films of runs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from swe_sphere.cli.options import Field, given, option, with_flags
from swe_sphere.errors import ConfigError
from swe_sphere.pictures.look import Look
from swe_sphere.planet import DAY
from swe_sphere.settings.values import validated

if TYPE_CHECKING:
    from swe_sphere.io.compare import Source
    from swe_sphere.pictures.exact import Exact

File = Annotated[Path, typer.Argument(help="File of a run; plot: also one that was regridded.")]


@with_flags(Look)
def plot(
    file: File,
    field: Field = None,
    time: float | None = option("DAYS", "Time of the frame (the last)."),
    out: Path | None = option("FILE.png", "The picture (beside the file: FILE_FIELD.png)."),
    compare: str | None = option("FILE.nc|exact", "Draw the difference from that."),
    **look: Any,
) -> None:
    """Draw a field of a file on the globe."""
    from swe_sphere.pictures.plot import plot_file

    seconds = None if time is None else time * DAY
    against = None if compare is None else _against(file, compare)
    typer.echo(plot_file(file, field, seconds, out, validated(Look, given(look, Look)), against))


@with_flags(Look, without=["panel"])
def animate(
    file: File,
    field: Field = None,
    out: Path | None = option("FILE.mp4|FILE.gif", "The film (beside: FILE_FIELD.mp4)."),
    rate: float = option("N", "Frames a second.", 8.0),
    **look: Any,
) -> None:
    """Make a film of all frames of a run."""
    from swe_sphere.pictures.animate import animate_file

    typer.echo(animate_file(file, field, out, validated(Look, given(look, Look)), rate))


def _against(file: Path, other: str) -> Source | Exact:
    """What the field is compared with: a file, or the exact solution of the file's scene."""
    from swe_sphere.io.compare import open_source

    if other != "exact":
        return open_source(other)
    from swe_sphere.io.runfile import RunFile
    from swe_sphere.pictures.exact import Exact
    from swe_sphere.simulation.build import make_scene
    from swe_sphere.simulation.config import make_config

    run = RunFile(file)
    told = run.attributes.get("configuration")
    if told is None:
        raise ConfigError(f"{file} does not say of which scene it is: compare with another file")
    return Exact(make_scene(make_config(json.loads(told))), run.mesh)
