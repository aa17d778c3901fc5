"""Spectral-element interpolation of nodal fields to arbitrary points of the sphere."""

import functools

import numpy as np
import scipy  # of which `sparse` is loaded where it is used, so that annotations quote it
from numpy.typing import ArrayLike

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import cubed_sphere
from swe_sphere.mesh.gll import lagrange
from swe_sphere.mesh.mesh import Mesh
from swe_sphere.mesh.sphere import frame, position

TILE = 20_000
"""Number of points per matrix, which bounds its memory."""

MOST_ENTRIES = 16_000_000
"""Largest number of entries of the matrices that an `Interpolator` keeps (200 MB)."""


class Interpolator:
    """Evaluates nodal fields, which are polynomials in each element, at fixed points.

    lon, lat [rad]: arrays that broadcast to one shape, with any longitude. Each tile of points has
    a matrix; all are kept for the next field if they have at most `MOST_ENTRIES` entries together.
    Raises ConfigError if a coordinate is not finite or a latitude is beyond the poles.
    """

    def __init__(self, mesh: Mesh, lon: ArrayLike, lat: ArrayLike) -> None:
        lon, lat = np.broadcast_arrays(np.array(lon, dtype=float), np.array(lat, dtype=float))
        if not (np.isfinite(lon).all() and (np.abs(lat) <= 0.5 * np.pi + 1e-12).all()):
            raise ConfigError("interpolation points need finite coordinates, |latitude| <= pi/2")
        self.mesh, self._lon, self._lat = mesh, lon, lat
        self._starts = range(0, max(lon.size, 1), TILE)
        keeps = lon.size * mesh.np**2 <= MOST_ENTRIES
        self._tile = functools.cache(self._build_tile) if keeps else self._build_tile

    def __call__(self, field: Array) -> Array:
        """Return values (*lon.shape, ...) at the points of nodal scalar fields (N, ...)."""
        rows = field.reshape(len(field), -1)
        values = np.concatenate([self._tile(start) @ rows for start in self._starts])
        return values.reshape(self._lon.shape + field.shape[1:])

    def wind(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Return the eastward and northward components at the points of the nodal wind u, v (N,).

        The interpolation uses Cartesian components, because u and v themselves jump at the poles.
        """
        values = self(u[:, None] * self.mesh.east + v[:, None] * self.mesh.north)
        east, north = frame(self._lon, self._lat)
        return np.sum(values * east, axis=-1), np.sum(values * north, axis=-1)

    def _build_tile(self, start: int) -> "scipy.sparse.csr_array":
        """Return the rows, of np^2 entries, of the matrix for the tile that begins at `start`."""
        mesh = self.mesh
        lon, lat = (x.ravel()[start : start + TILE] for x in (self._lon, self._lat))
        element, xi1, xi2 = cubed_sphere.locate(mesh.placement.lift(position(lon, lat)), mesh.ne)
        first, second = lagrange(mesh.gll_points, xi1), lagrange(mesh.gll_points, xi2)
        values = first[:, :, None] * second[:, None, :]
        starts = np.arange(lon.size + 1, dtype=np.int32) * mesh.np**2
        entries = (values.ravel(), mesh.nodes[element].ravel(), starts)
        return scipy.sparse.csr_array(entries, shape=(lon.size, mesh.size))
