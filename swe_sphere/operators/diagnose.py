"""Relative vorticity and divergence of a wind at the nodes, for diagnostics and output."""

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.mesh import Mesh

FIRST, SECOND = "im,mje->eij", "jm,ime->eij"
"""Subscripts of derivatives along xi1 and xi2."""


def assemble(mesh: Mesh, weighted: Array) -> Array:
    """Return mass-weighted values (E, np, np) after DSS (N,): their sums divided by nodal areas."""
    return np.bincount(mesh.nodes.ravel(), weighted.ravel(), mesh.size) / mesh.area


def vorticity(mesh: Mesh, u: Array, v: Array) -> Array:
    """Return the relative vorticity (N,) [s-1] of eastward and northward wind (N,) [m s-1].

    The vorticity (D1 u_2 - D2 u_1)/J becomes continuous by DSS (Taylor & Fournier 2010,
    doi:10.1016/j.jcp.2010.04.008, eq. 33).
    """
    b, wind_u, wind_v = mesh.basis, u[mesh.nodes], v[mesh.nodes]
    covariant_1 = b[..., 0, 0] * wind_u + b[..., 0, 1] * wind_v
    covariant_2 = b[..., 1, 0] * wind_u + b[..., 1, 1] * wind_v
    curl = _slope(mesh, FIRST, covariant_2) - _slope(mesh, SECOND, covariant_1)
    return assemble(mesh, mesh.quadrature * curl)


def divergence(mesh: Mesh, u: Array, v: Array) -> Array:
    """Return the divergence (N,) [s-1] of eastward and northward wind (N,) [m s-1]."""
    b, wind_u, wind_v = mesh.basis, u[mesh.nodes], v[mesh.nodes]
    flux_1 = b[..., 1, 1] * wind_u - b[..., 1, 0] * wind_v
    flux_2 = b[..., 0, 0] * wind_v - b[..., 0, 1] * wind_u
    outflow = _slope(mesh, FIRST, flux_1) + _slope(mesh, SECOND, flux_2)
    return assemble(mesh, mesh.quadrature * outflow)


def _slope(mesh: Mesh, along: str, field: Array) -> Array:
    """Return the derivative (E, np, np) of a field (E, np, np) along one coordinate.

    along: the subscripts of that coordinate.
    """
    # elements last: sums then run along many elements, in a third of the time
    by_point = np.ascontiguousarray(np.moveaxis(field, 0, -1))
    return np.asarray(np.einsum(along, mesh.derivative, by_point))
