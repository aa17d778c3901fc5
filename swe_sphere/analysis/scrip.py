"""The nodes of a mesh as cells, in the SCRIP format that ESMF and others read.

Format: Jones (1998), A User's Guide for SCRIP, section 3.2.
"""

from __future__ import annotations

from pathlib import Path

import netCDF4
import numpy as np

from swe_sphere.durable import clear_errors, part_of, refuse_to_replace
from swe_sphere.io.layout import history
from swe_sphere.io.runfile import RunFile
from swe_sphere.mesh import Mesh
from swe_sphere.mesh.cells import CORNERS, cell_corners


def write_scrip(path: Path, out: Path, overwrite: bool = False) -> Path:
    """Write the cells of a run's nodes as a SCRIP grid: centres, corners, areas [rad2].

    Areas are the quadrature weights, with which integrals are those of the run.  Raises ConfigError
    if the file is not of a run, or if `out` is there already or cannot be written.
    """
    mesh = RunFile(path).mesh
    refuse_to_replace(out, overwrite)
    part = part_of(out)
    with clear_errors(f"cannot write {out}"):
        try:
            with netCDF4.Dataset(part, "w", format="NETCDF3_64BIT_OFFSET") as file:
                _fill(file, mesh, path)
            part.replace(out)
        finally:
            part.unlink(missing_ok=True)
    return out


def _fill(file: netCDF4.Dataset, mesh: Mesh, path: Path) -> None:
    file.setncatts({"title": f"nodes of {mesh!r}", "history": history(f"scrip {path.name}")})
    for name, size in {"grid_size": mesh.size, "grid_corners": CORNERS, "grid_rank": 1}.items():
        file.createDimension(name, size)
    lon, lat = map(np.degrees, cell_corners(mesh))
    cells, corners = ("grid_size",), ("grid_size", "grid_corners")
    for name, dimensions, values, units in (
        ("grid_center_lat", cells, np.degrees(mesh.lat), "degrees"),
        ("grid_center_lon", cells, np.degrees(mesh.lon), "degrees"),
        ("grid_corner_lat", corners, lat, "degrees"),
        ("grid_corner_lon", corners, lon, "degrees"),
        ("grid_area", cells, mesh.area / mesh.radius**2, "radians^2"),
        ("grid_imask", cells, np.ones(mesh.size, dtype=np.int32), "unitless"),
        ("grid_dims", ("grid_rank",), np.array([mesh.size], dtype=np.int32), "unitless"),
    ):
        variable = file.createVariable(name, values.dtype, dimensions)
        variable.units = units
        variable[:] = values
