"""`swe-sphere list`, `compare`, `regrid` and `scrip`: what there is, and files for other tools."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Annotated

import typer

from swe_sphere.cli.options import AsJson, Field, flag, option
from swe_sphere.planet import DAY
from swe_sphere.settings.values import names_in

Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace a file that is there.")]


def list_all() -> None:
    """List the scenes and steppers, one line each."""
    from swe_sphere.steppers import list_steppers
    from swe_sphere.testcases import list_scenes

    for title, lines in {"Scenes": list_scenes(), "Steppers": list_steppers()}.items():
        width = max(map(len, lines))
        typer.echo(f"{title}:")
        for name, text in lines.items():
            typer.echo(f"  {name:{width}}  {text}")


def compare(
    a: Annotated[Path, typer.Argument(help="File whose errors are wanted.")],
    b: Annotated[Path, typer.Argument(help="File taken for right; any other grid.")],
    field: Field = None,
    time: float | None = option("DAYS", "Time of both (the last that both have)."),
    across_scenes: bool = flag("across-scenes", "Also runs of different scenes."),
    as_json: AsJson = False,
) -> None:
    """Print l1, l2 and linf of A against B."""
    from swe_sphere.io.compare import compare as compare_files

    seconds = None if time is None else time * DAY
    result = compare_files(a, b, field, seconds, across_scenes)
    if as_json:
        typer.echo(json.dumps(result))
        return
    when = "" if result["time"] is None else f" at day {float(result['time']) / DAY:g}"
    typer.echo(f"{result['field']}{when}")
    for norm in ("l1", "l2", "linf"):
        typer.echo(f"  {norm:5} {result[norm]:.6e}")


def regrid(
    file: Annotated[Path, typer.Argument(help="File of a run.")],
    grid: str = option("latlon:ROWSxCOLUMNS|gaussian:N", "The grid.", "latlon:181x360"),
    out: Path | None = option("FILE.nc|FILE.zarr", "The result (beside: FILE_GRID.nc)."),
    conservative: bool = flag("conservative", "Cell means that keep the integrals."),
    fields: str | None = option("A,B,...", "Variables wanted (all)."),
    overwrite: Overwrite = False,
) -> None:
    """Bring the frames of a run to a grid of latitudes and longitudes."""
    from swe_sphere.analysis.regrid_file import regrid_file

    place = out or file.with_name(f"{file.stem}_{re.sub(r'[^a-z0-9]', '', grid)}.nc")
    typer.echo(regrid_file(file, grid, place, conservative, names_in(fields), overwrite))


def scrip(
    file: Annotated[Path, typer.Argument(help="File of a run.")],
    out: Path | None = option("FILE.nc", "The grid (beside: FILE_scrip.nc)."),
    overwrite: Overwrite = False,
) -> None:
    """Write the nodes as cells of a SCRIP grid, for other tools that regrid."""
    from swe_sphere.analysis.regrid_file import write_scrip

    typer.echo(write_scrip(file, out or file.with_name(f"{file.stem}_scrip.nc"), overwrite))
