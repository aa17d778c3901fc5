"""The nodes of a mesh as cells, for tools that know values of cells alone.

Each sub-quad of an element holds one corner, where the reference square is cut in proportion to the
quadrature weights: the cell of a node is then, on a square element, as large as its weight says.
The cells cover the sphere; edges are great circles.
"""

from __future__ import annotations

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.mesh.gll import lagrange
from swe_sphere.mesh.mesh import Mesh
from swe_sphere.mesh.sphere import longitude_latitude

CORNERS = 4
"""Of a cell; at the corners of the cube there are three, of which the last is given twice."""


def cell_corners(mesh: Mesh) -> tuple[Array, Array]:
    """Longitude and latitude (N, 4) [rad] of the corners of each cell, anticlockwise."""
    cuts = np.cumsum(mesh.gll_weights)[:-1] - 1.0
    at = lagrange(mesh.gll_points, cuts)
    inside = np.einsum("ai,bj,eijx->eabx", at, at, mesh.xyz[mesh.nodes]).reshape(-1, 3)
    inside /= np.linalg.norm(inside, axis=1)[:, None]
    quads = mesh.quads()
    turn = np.empty(quads.shape)
    for k, node in enumerate(quads.T):  # one after the other: large meshes
        away = inside - mesh.xyz[node]
        north, east = (np.einsum("qx,qx->q", away, x[node]) for x in (mesh.north, mesh.east))
        turn[:, k] = np.arctan2(north, east)
    order = np.lexsort((turn.ravel(), quads.ravel())) // CORNERS
    number = np.bincount(quads.ravel(), minlength=mesh.size)
    starts = np.cumsum(number) - number
    around = order[starts[:, None] + np.minimum(np.arange(CORNERS), number[:, None] - 1)]
    lon, lat = longitude_latitude(inside)
    return lon[around], lat[around]
