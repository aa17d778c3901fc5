"""Gauss-Lobatto-Legendre points, weights, derivative and Lagrange cardinal functions on [-1, 1].

Formulas: Canuto, Hussaini, Quarteroni, Zang, "Spectral Methods: Fundamentals in Single
Domains" (2006), section 2.3; barycentric derivative: Berrut & Trefethen (2004),
doi:10.1137/S0036144502417715, eq. 9.4.
"""

import numpy as np
from numpy.polynomial import legendre

from swe_sphere.arrays import Array


def gll_points(np_: int) -> Array:
    """Return the np_ Gauss-Lobatto-Legendre points (np_,), ascending, exactly antisymmetric."""
    last = legendre.Legendre.basis(np_ - 1)
    slope, curvature = last.deriv(), last.deriv(2)
    inner = np.sort(slope.roots().real)
    for _ in range(3):  # the companion-matrix roots are accurate to 1e-14 only
        inner = inner - slope(inner) / curvature(inner)
    points = np.concatenate(([-1.0], inner, [1.0]))
    return 0.5 * (points - points[::-1])


def gll_weights(points: Array) -> Array:
    """Return the weights (np,) of the GLL points: 2 / (n (n-1) P_{n-1}(x)^2); their sum is 2."""
    n = points.size
    values = legendre.Legendre.basis(n - 1)(points)
    values = 0.5 * (np.abs(values) + np.abs(values[::-1]))  # exactly symmetric
    return np.asarray(2.0 / (n * (n - 1) * values**2))


def derivative_matrix(points: Array) -> Array:
    """Return the matrix D (np, np) with (D f)_i = f'(x_i) for each polynomial f of degree np - 1.

    Each diagonal entry is minus the sum of the others in its row: constants have derivative zero.
    """
    gaps = points[:, None] - points[None, :]
    np.fill_diagonal(gaps, 1.0)
    scale = np.prod(gaps, axis=1)
    matrix: Array = scale[:, None] / scale[None, :] / gaps
    np.fill_diagonal(matrix, 0.0)
    np.fill_diagonal(matrix, -matrix.sum(axis=1))
    return matrix


def lagrange(points: Array, x: Array) -> Array:
    """Return the cardinal functions (len(x), np) of the given nodes (np,) at the points x."""
    # the product form needs no special case where x is a node
    values = np.ones((x.size, points.size))
    for i, node in enumerate(points):
        for other in np.delete(points, i):
            values[:, i] *= (x - other) / (node - other)
    return values
