"""Spherical harmonics: fields from coefficients at any points, coefficients on a Gauss grid.

A field of degree up to L has complex coefficients c (L+1, L+1), degree n by order m ≥ 0:

    field(λ, θ) = Re Σ c[n, m] P_nm(sin θ) exp(i m λ),

where the mean of P_nm² over the sphere is one. Derivatives are finite at the poles: for m ≥ 1 the
recurrence runs on P_nm / cos θ, which is a polynomial times cos^(m-1) θ.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from swe_sphere.equations.scene import Array

Complex = NDArray[np.complex128]
CHUNK = 4096
"""Points that are treated together: so much memory a degree."""


def synthesis(coefficients: Complex, lon: Array, lat: Array) -> tuple[Array, Array, Array]:
    """Fields, ∂/∂λ / cos θ and ∂/∂θ [rad-1] of them, at points [rad] of any shape.

    coefficients: of one field (L+1, L+1), or of several (k, L+1, L+1), which is cheaper than one by
    one; then each result has the leading dimension k.
    """
    shape = np.broadcast_shapes(np.shape(lon), np.shape(lat))
    flat = [np.broadcast_to(x, shape).ravel() for x in (lon, lat)]
    stack = coefficients.reshape(-1, *coefficients.shape[-2:])
    found = np.empty((3, len(stack), flat[0].size))
    for start in range(0, flat[0].size, CHUNK):
        part = slice(start, start + CHUNK)
        found[..., part] = _summed(stack, flat[0][part], flat[1][part])
    value, east, north = found.reshape(3, *coefficients.shape[:-2], *shape)
    return value, east, north


def _summed(coefficients: Complex, lon: Array, lat: Array) -> Array:
    """Values and derivatives (3, k, points)."""
    cos, sine, total = np.cos(lat), np.sin(lat), np.zeros((3, len(coefficients), len(lat)))
    used: NDArray[np.bool_] = np.asarray(coefficients.any(axis=(0, 1)))
    used[1:2] |= used[:1]  # slopes of P_n0 are made of P_n1: see below
    for m, q in enumerate(_orders(coefficients.shape[1] - 1, lat, used)):
        if not used[m]:
            continue
        c, n = coefficients[:, m:, m], np.arange(m, coefficients.shape[1])
        value, sloped, shifted = _products([c, n * c, _shifted(c, n, m)], q)
        wave = np.exp(1j * m * lon)
        value, north = value * wave, (shifted - sine * sloped) * wave
        if m:
            total += np.stack([cos * value.real, -m * value.imag, north.real])
        else:
            total[0] += value.real
        if m == 1:
            first = np.sqrt(n * (n + 1.0)) * coefficients[:, 1:, 0]
            total[2] += cos * (first.real @ q)
    return total


def _products(rows: list[Complex], q: Array) -> Complex:
    """Complex (3, k, n) times real (n, points), without a complex copy of the latter."""
    left = np.stack(rows)
    both: Array = np.concatenate([left.real, left.imag]) @ q
    product: Complex = both[:3] + 1j * both[3:]
    return product


def _shifted(c: Complex, n: NDArray[np.integer], m: int) -> Complex:
    """The coefficients of P_n in Σ c_n √((n² - m²) (2n + 1)/(2n - 1)) P_(n-1)."""
    back = np.sqrt((n**2 - m**2) * (2.0 * n + 1.0) / np.abs(2.0 * n - 1.0))
    shifted = np.zeros_like(c)
    shifted[:, :-1] = (back * c)[:, 1:]
    return shifted


def _orders(degree: int, lat: Array, wanted: NDArray[np.bool_] | None = None) -> Iterator[Array]:
    """P_n0, then P_nm / cos θ for m = 1, 2, …: each (degree + 1 - m, points), empty if unwanted."""
    sine, cos, start = np.sin(lat), np.cos(lat), np.full_like(lat, np.sqrt(1.5))
    tops = np.full(degree + 1, degree) if wanted is None else np.where(wanted, degree, -1)
    yield _column(tops[0], 0, sine, np.ones_like(lat))
    for m in range(1, degree + 1):
        yield _column(tops[m], m, sine, start)
        start = np.sqrt((2 * m + 3) / (2 * m + 2)) * cos * start


def _column(degree: int, m: int, sine: Array, start: Array) -> Array:
    """P_nm for n = m … degree (rows) from the first; any factor of the first carries through."""
    column = np.empty((max(degree + 1 - m, 0), len(sine)))
    column[:1] = start
    for n in range(m + 1, degree + 1):
        row, factor = n - m, np.sqrt((4 * n**2 - 1) / (n**2 - m**2))
        np.multiply(sine, column[row - 1], out=column[row])
        column[row] *= factor
        if row > 1:
            less = factor * np.sqrt(((n - 1) ** 2 - m**2) / (4 * (n - 1) ** 2 - 1))
            column[row] -= less * column[row - 2]
    return column


def legendre(degree: int, lat: Array) -> Iterator[tuple[Array, Array, Array]]:
    """For m = 0, 1, …: P_nm, P_nm / cos θ (zero for m = 0) and dP_nm/dθ at latitudes [rad].

    Each (degree + 1 - m, points), for n = m … degree.
    """
    sine, cos = np.sin(lat), np.cos(lat)
    orders = _orders(degree, lat)
    zonal, first = next(orders), next(orders, np.empty((0, len(lat))))
    n = np.arange(1, degree + 1)[:, None]
    yield (
        zonal,
        0.0 * zonal,
        np.concatenate([0.0 * zonal[:1], np.sqrt(n * (n + 1.0)) * cos * first]),
    )
    for m, q in enumerate(chain([first], orders) if degree else orders, start=1):
        n = np.arange(m, degree + 1)[:, None]
        slope = -n * sine * q
        slope[1:] += np.sqrt((n**2 - m**2) * (2.0 * n + 1.0) / (2.0 * n - 1.0))[1:] * q[:-1]
        yield cos * q, q, slope


@dataclass(frozen=True)
class GaussGrid:
    """Points on which products of fields up to a total degree are integrated exactly.

    Args:
        degree: the highest degree of coefficients asked for; fields may have the same degree.
    """

    degree: int

    @property
    def points(self) -> tuple[Array, Array]:
        """Longitudes and latitudes [rad], each (latitudes, longitudes)."""
        sine, _ = np.polynomial.legendre.leggauss(self.degree + 1)
        count = 2 * self.degree + 2
        lon = 2.0 * np.pi * np.arange(count) / count
        around, up = np.meshgrid(lon, np.arcsin(sine))
        return around, up

    def coefficients(self, field: Array) -> Complex:
        """The coefficients of a field on the grid."""
        still = np.zeros_like(field)
        return self._projected(field, still, still)

    def against_gradients(self, east: Array, north: Array) -> Complex:
        """Coefficients c[n, m] of -∇·F on the unit sphere for a vector field F on the grid."""
        return self._projected(np.zeros_like(east), east, north)

    def _projected(self, field: Array, east: Array, north: Array) -> Complex:
        """Means over the sphere of field Y* + F·∇Y*, doubled for m > 0."""
        sine, weights = np.polynomial.legendre.leggauss(self.degree + 1)
        lat, found = np.arcsin(sine), np.zeros((self.degree + 1,) * 2, dtype=np.complex128)
        waves = [np.fft.fft(f, axis=1, norm="forward") for f in (field, east, north)]
        for m, (polynomial, over_cos, slope) in enumerate(legendre(self.degree, lat)):
            value, along, across = (0.5 * weights * wave[:, m] for wave in waves)
            mean = polynomial @ value - 1j * m * (over_cos @ along) + slope @ across
            found[m:, m] = mean * (2.0 if m else 1.0)
        return found
