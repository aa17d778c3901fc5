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

MOST_ENTRIES = 16_000_000
"""Largest number of entries of the matrices that a `Sampler` keeps (200 MB)."""


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
        xyz = position(lon.ravel(), lat.ravel())
        element, xi1, xi2 = cubed_sphere.locate(mesh.placement.lift(xyz), mesh.ne)
        first, second = lagrange(mesh.gll_points, xi1), lagrange(mesh.gll_points, xi2)
        values = first[:, :, None] * second[:, None, :]
        starts = np.arange(lon.size + 1) * mesh.np**2
        entries = (values.ravel(), mesh.nodes[element].ravel(), starts)
        self.matrix = scipy.sparse.csr_array(entries, shape=(lon.size, mesh.size))

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


class Sampler:
    """Evaluates nodal fields at any number of points, as `Interpolator` does.

    lon, lat (P,) [rad].  The matrices of a tile of points at a time are built; they are kept for
    the next field if all of them have at most `MOST_ENTRIES` entries.
    """

    def __init__(self, mesh: Mesh, lon: Array, lat: Array) -> None:
        self._mesh, self._lon, self._lat = mesh, lon, lat
        self._keeps = lon.size * mesh.np**2 <= MOST_ENTRIES
        self._kept: list[Interpolator] = []

    def __call__(self, fields: Array) -> Array:
        """Return scalar fields (N, ...) at the points, (P, ...)."""
        return np.concatenate([tile.matrix @ fields for tile in self._tiles()])

    def wind(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Return the eastward and northward wind (P,) at the points of the nodal wind u, v (N,)."""
        east, north = np.concatenate([tile.wind(u, v) for tile in self._tiles()], axis=-1)
        return east, north

    def _tiles(self) -> Iterator[Interpolator]:
        if self._kept:
            yield from self._kept
            return
        built = []
        for start in range(0, self._lon.size, TILE):
            part = slice(start, start + TILE)
            tile = Interpolator(self._mesh, self._lon[part], self._lat[part])
            built += [tile] if self._keeps else []
            yield tile
        self._kept = built
