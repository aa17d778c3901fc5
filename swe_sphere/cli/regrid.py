"""`swe-sphere regrid` and `scrip`: runs on other grids, and their grid for other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from swe_sphere.settings import names_in


def regrid(
    file: Annotated[Path, typer.Argument(help="File of a run.")],
    grid: Annotated[
        str, typer.Option(metavar="latlon:ROWSxCOLUMNS|gaussian:N", help="The grid.")
    ] = "latlon:181x360",
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.nc|FILE.zarr", help="The result (beside: FILE_GRID.nc)."),
    ] = None,
    conservative: Annotated[
        bool, typer.Option("--conservative", help="Cell means that keep the integrals.")
    ] = False,
    fields: Annotated[
        str | None, typer.Option(metavar="A,B,...", help="Variables wanted (all).")
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace a file that is there.")
    ] = False,
) -> None:
    """Bring the frames of a run to a grid of latitudes and longitudes."""
    from swe_sphere.analysis.regrid_file import regrid_file

    place = out or file.with_name(f"{file.stem}_{grid.replace(':', '')}.nc")
    typer.echo(regrid_file(file, grid, place, conservative, names_in(fields), overwrite))


def scrip(
    file: Annotated[Path, typer.Argument(help="File of a run.")],
    out: Annotated[
        Path | None, typer.Option(metavar="FILE.nc", help="The grid (beside: FILE_scrip.nc).")
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace a file that is there.")
    ] = False,
) -> None:
    """Write the nodes as cells of a SCRIP grid, for other tools that regrid."""
    from swe_sphere.analysis.regrid_file import write_scrip

    typer.echo(write_scrip(file, out or file.with_name(f"{file.stem}_scrip.nc"), overwrite))
