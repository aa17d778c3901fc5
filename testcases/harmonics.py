"""Spherical harmonics: fields from coefficients at any points, coefficients on a Gauss grid.

A field of degree up to L has complex coefficients c (L+1, L+1), degree n by order m ≥ 0:

    field(λ, θ) = Re Σ c[n, m] P_nm(sin θ) exp(i m λ),

where the mean of P_nm² over the sphere is one. Derivatives are finite at the poles: for m ≥ 1 the
recurrence runs on P_nm / cos θ, which is a polynomial times cos^(m-1) θ.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from swe_sphere.model.scene import Array

__all__ = ["Complex", "GaussGrid", "synthesis"]

Complex = NDArray[np.complex128]
CHUNK = 16384
"""Points that are treated together: so much memory a degree."""


def synthesis(coefficients: Complex, lon: Array, lat: Array) -> tuple[Array, Array, Array]:
    """The field, ∂/∂λ / cos θ and ∂/∂θ [rad-1] of it, at points [rad] of any shape."""
    shape = np.broadcast_shapes(np.shape(lon), np.shape(lat))
    flat = [np.broadcast_to(x, shape).ravel() for x in (lon, lat)]
    found = np.empty((3, flat[0].size))
    for start in range(0, flat[0].size, CHUNK):
        part = slice(start, start + CHUNK)
        found[:, part] = _summed(coefficients, flat[0][part], flat[1][part])
    value, east, north = found.reshape(3, *shape)
    return value, east, north


def _summed(coefficients: Complex, lon: Array, lat: Array) -> Array:
    """Value and derivatives (3, points)."""
    cos, total = np.cos(lat), np.zeros((3, len(lat)))
    for m, (q, slope) in enumerate(_orders(len(coefficients) - 1, lat)):
        c = coefficients[m:, m]
        wave = np.exp(1j * m * lon)
        total[0] += ((c @ q) * wave).real * (cos if m else 1.0)
        total[1] += (1j * m * (c @ q) * wave).real
        total[2] += ((c @ slope) * wave).real
    return total


def _orders(degree: int, lat: Array) -> Iterator[tuple[Array, Array]]:
    """For m = 0, 1, …: P_nm / cos θ (P_n0 for m = 0) and dP_nm/dθ, both (L + 1 - m, points)."""
    sine, cos = np.sin(lat), np.cos(lat)
    one = _column(degree, 1, sine, np.sqrt(1.5) + 0.0 * lat) if degree else np.zeros((0, len(lat)))
    start = np.ones_like(lat)
    for m in range(degree + 1):
        n = np.arange(m, degree + 1)[:, None]
        if m == 0:  # d/dθ of P_n0 is √(n(n+1)) P_n1
            column = _column(degree, 0, sine, start)
            slope = np.concatenate([0.0 * column[:1], np.sqrt(n[1:] * (n[1:] + 1.0)) * one * cos])
            start = np.sqrt(1.5) * start
        else:
            column = one if m == 1 else _column(degree, m, sine, start)
            back = np.sqrt((n**2 - m**2) * (2 * n + 1) / (2 * n - 1))
            slope = -n * sine * column
            slope[1:] += back[1:] * column[:-1]
            start = np.sqrt((2 * m + 3) / (2 * m + 2)) * cos * start
        yield column, slope


def _column(degree: int, m: int, sine: Array, start: Array) -> Array:
    """P_nm for n = m … degree (rows) from the first; any factor of the first carries through."""
    column = np.empty((degree + 1 - m, len(sine)))
    column[0] = start
    for n in range(m + 1, degree + 1):
        row = n - m
        column[row] = sine * column[row - 1]
        if row > 1:
            column[row] -= np.sqrt(((n - 1) ** 2 - m**2) / (4 * (n - 1) ** 2 - 1)) * column[row - 2]
        column[row] *= np.sqrt((4 * n**2 - 1) / (n**2 - m**2))
    return column


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
        for m, (q, slope) in enumerate(_orders(self.degree, lat)):
            value, along, across = (0.5 * weights * wave[:, m] for wave in waves)
            polynomial = q * np.cos(lat) if m else q
            mean = polynomial @ value - 1j * m * (q @ along) + slope @ across
            found[m:, m] = mean * (2.0 if m else 1.0)
        return found
