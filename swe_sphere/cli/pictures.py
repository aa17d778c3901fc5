"""`swe-sphere plot` and `animate`: pictures and films of runs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from swe_sphere.errors import ConfigError
from swe_sphere.planet import DAY

if TYPE_CHECKING:
    from swe_sphere.io.compare import Source
    from swe_sphere.pictures.exact import Exact
    from swe_sphere.pictures.look import Look

File = Annotated[Path, typer.Argument(help="File of a run; plot: also one that was regridded.")]
Field = Annotated[
    str | None, typer.Option("--field", metavar="NAME", help="h, surface, vorticity, ...")
]
Projection = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="equal-earth, robinson, lat-lon, orthographic, north-polar, south-polar.",
    ),
]
Centre = Annotated[
    str, typer.Option(metavar="LON|LON,LAT", help="Middle of the map (LAT: orthographic).")
]
Region = Annotated[
    str | None, typer.Option(metavar="W,E,S,N", help="Part of the globe that is shown.")
]
Limits = Annotated[str | None, typer.Option(metavar="LOW,HIGH", help="Ends of the colour scale.")]
Levels = Annotated[int | None, typer.Option(metavar="N", help="About how many contours.")]
Colours = Annotated[
    str | None, typer.Option(metavar="NAME", help="Colour map of cmocean or matplotlib.")
]
Contours = Annotated[
    bool | None, typer.Option("--contours/--no-contours", help="Where they are readable.")
]
MeshLines = Annotated[bool, typer.Option("--mesh", help="Draw the edges of the elements.")]
Winds = Annotated[str | None, typer.Option(metavar="arrows|streamlines", help="Draw the wind.")]


def plot(
    file: File,
    field: Field = None,
    time: Annotated[
        float | None, typer.Option(metavar="DAYS", help="Time of the frame (the last).")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.png", help="The picture (beside the file: FILE_FIELD.png)."),
    ] = None,
    projection: Projection = "equal-earth",
    centre: Centre = "0",
    region: Region = None,
    limits: Limits = None,
    levels: Levels = None,
    colours: Colours = None,
    contours: Contours = None,
    panel: Annotated[
        bool, typer.Option("--panel/--no-panel", help="Curves of errors and drifts.")
    ] = True,
    mesh: MeshLines = False,
    winds: Winds = None,
    compare: Annotated[
        str | None,
        typer.Option(metavar="FILE.nc|exact", help="Draw the difference from that."),
    ] = None,
) -> None:
    """Draw a field of a file on the globe."""
    from swe_sphere.pictures.plot import plot_file

    look = _look(projection, centre, region, limits, levels, colours, contours, panel, mesh, winds)
    seconds = None if time is None else time * DAY
    against = None if compare is None else _against(file, compare)
    typer.echo(plot_file(file, field, seconds, out, look, against))


def animate(
    file: File,
    field: Field = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.mp4|FILE.gif", help="The film (beside: FILE_FIELD.mp4)."),
    ] = None,
    rate: Annotated[float, typer.Option(metavar="N", help="Frames a second.")] = 8.0,
    projection: Projection = "equal-earth",
    centre: Centre = "0",
    region: Region = None,
    limits: Limits = None,
    levels: Levels = None,
    colours: Colours = None,
    contours: Contours = None,
    mesh: MeshLines = False,
    winds: Winds = None,
) -> None:
    """Make a film of all frames of a run."""
    from swe_sphere.pictures.animate import animate_file

    look = _look(projection, centre, region, limits, levels, colours, contours, False, mesh, winds)
    typer.echo(animate_file(file, field, out, look, rate))


def _look(
    projection: str,
    centre: str,
    region: str | None,
    limits: str | None,
    levels: int | None,
    colours: str | None,
    contours: bool | None,
    panel: bool,
    mesh: bool,
    winds: str | None,
) -> Look:
    from swe_sphere.pictures.look import Look

    lon, lat = (*_numbers("centre", centre, (1, 2)), 0.0)[:2]
    west_east_south_north = region and _numbers("region", region, (4,))
    low_high = limits and _numbers("limits", limits, (2,))
    return Look(
        projection, (lon, lat), west_east_south_north or None, low_high or None,  # type: ignore[arg-type]
        levels, colours, contours, panel, mesh, winds,
    )  # fmt: skip


def _numbers(flag: str, text: str, counts: tuple[int, ...]) -> tuple[float, ...]:
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = ()
    if len(found) not in counts:
        wanted = " or ".join(map(str, counts))
        raise ConfigError(f"{flag}: {wanted} numbers, separated by commas, not {text!r}")
    return found


def _against(file: Path, other: str) -> Source | Exact:
    """What the field is compared with: a file, or the exact solution of the file's scene."""
    from swe_sphere.io.compare import open_source

    if other != "exact":
        return open_source(other)
    from swe_sphere.io.runfile import RunFile
    from swe_sphere.pictures.exact import Exact
    from swe_sphere.simulation.config import make_config
    from swe_sphere.simulation.setup import make_scene

    run = RunFile(file)
    told = run.attributes.get("configuration")
    if told is None:
        raise ConfigError(f"{file} does not say of which scene it is: compare with another file")
    return Exact(make_scene(make_config(json.loads(told))), run.mesh)
