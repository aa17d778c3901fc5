"""Spectral-element interpolation of nodal fields to any points of the sphere."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy
from numpy.typing import ArrayLike

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import cubed_sphere
from swe_sphere.mesh.gll import lagrange
from swe_sphere.mesh.mesh import Mesh
from swe_sphere.mesh.sphere import frame, position

TILE = 20_000
"""Points whose matrix is made at once, which bounds its memory."""


class Interpolator:
    """Evaluates nodal fields, as the polynomials they are in each element, at fixed points.

    lon, lat [rad]: arrays of one shape (any longitude).  `matrix` is the CSR matrix (points, N)
    with np^2 entries a row.  Raises ConfigError where a coordinate is not finite or a latitude
    is beyond the poles.
    """

    matrix: scipy.sparse.csr_array

    def __init__(self, mesh: Mesh, lon: ArrayLike, lat: ArrayLike) -> None:
        lon, lat = np.broadcast_arrays(np.asarray(lon, dtype=float), np.asarray(lat, dtype=float))
        if not (np.isfinite(lon).all() and (np.abs(lat) <= 0.5 * np.pi + 1e-12).all()):
            raise ConfigError("interpolation points need finite coordinates, |latitude| <= pi/2")
        self.mesh = mesh
        self.shape = lon.shape
        self._frame = frame(lon, lat)
        self.matrix = _matrix(mesh, position(lon.ravel(), lat.ravel()))

    def __call__(self, field: Array) -> Array:
        """Values of the nodal scalar field (N,) at the points, in the shape of lon and lat."""
        values: Array = self.matrix @ field
        return values.reshape(self.shape)

    def wind(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Eastward and northward components at the points of the nodal wind u, v (N,).

        Goes through Cartesian components: the components u and v themselves jump at the poles.
        """
        cartesian = u[:, None] * self.mesh.east + v[:, None] * self.mesh.north
        values = (self.matrix @ cartesian).reshape(*self.shape, 3)
        east, north = self._frame
        return np.sum(values * east, axis=-1), np.sum(values * north, axis=-1)


def interpolators(mesh: Mesh, lon: Array, lat: Array) -> Iterator[Interpolator]:
    """Those of points lon, lat (M,) [rad], some of them at a time, in order."""
    for start in range(0, lon.size, TILE):
        part = slice(start, start + TILE)
        yield Interpolator(mesh, lon[part], lat[part])


def _matrix(mesh: Mesh, xyz: Array) -> scipy.sparse.csr_array:
    """Interpolation matrix (T, N) for unit vectors (T, 3)."""
    element, xi1, xi2 = cubed_sphere.locate(mesh.placement.lift(xyz), mesh.ne)
    first, second = lagrange(mesh.gll_points, xi1), lagrange(mesh.gll_points, xi2)
    values = first[:, :, None] * second[:, None, :]
    starts = np.arange(len(xyz) + 1) * mesh.np**2
    entries = (values.ravel(), mesh.nodes[element].ravel(), starts)
    return scipy.sparse.csr_array(entries, shape=(len(xyz), mesh.size))
