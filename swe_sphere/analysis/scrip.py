"""The nodes of a mesh as cells, in the SCRIP format that cdo, ESMF and uxarray read.

Each sub-quad of an element holds one corner, where the reference square is cut in proportion to the
quadrature weights: the cell of a node is then, on a square element, as large as its weight says.
The cells cover the sphere; edges are great circles.
Format: Jones (1998), A User's Guide for SCRIP, section 3.2.
"""

from __future__ import annotations

from pathlib import Path

import netCDF4
import numpy as np
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.durable import clear_errors, part_of, refuse_to_replace
from swe_sphere.io.history import history
from swe_sphere.io.runfile import RunFile
from swe_sphere.mesh import Mesh
from swe_sphere.mesh.gll import lagrange
from swe_sphere.sphere import longitude_latitude

CORNERS = 4
"""Of a cell; at the corners of the cube there are three, of which the last is given twice."""


def cell_corners(mesh: Mesh) -> Array:
    """Unit vectors (N, 4, 3) of the corners of each cell, anticlockwise seen from outside."""
    cuts = np.cumsum(mesh.gll_weights)[:-1] - 1.0
    at = lagrange(mesh.gll_points, cuts)
    inside = np.einsum("ai,bj,eijx->eabx", at, at, mesh.xyz[mesh.nodes]).reshape(-1, 3)
    inside /= np.linalg.norm(inside, axis=1)[:, None]
    order, number = _around(mesh, inside)
    padded = np.minimum(np.arange(CORNERS), number[:, None] - 1)
    starts = np.concatenate([[0], np.cumsum(number)[:-1]])
    result: Array = inside[order[starts[:, None] + padded]]
    return result


def _around(mesh: Mesh, inside: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Corners of node after node, anticlockwise, and how many each has."""
    quads = mesh.quads()
    node, corner = quads.ravel(), np.repeat(np.arange(len(quads)), CORNERS)
    away = inside[corner] - mesh.xyz[node]
    turn = np.arctan2(
        np.sum(away * mesh.north[node], axis=1), np.sum(away * mesh.east[node], axis=1)
    )
    order = np.lexsort((turn, node))
    return corner[order], np.bincount(node, minlength=mesh.size)


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
    lon, lat = (np.degrees(x) for x in longitude_latitude(cell_corners(mesh)))
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
