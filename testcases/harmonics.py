"""Spherical harmonics, balanced flows built from them, and the scene `turbulence`.

A field of degree up to L has complex coefficients c (L+1, L+1), degree n by order m ≥ 0:

    field(λ, θ) = Re Σ c[n, m] P_nm(sin θ) exp(i m λ),

where the mean of P_nm² over the sphere is one. Derivatives are finite at the poles: for m ≥ 1 the
recurrence runs on P_nm / cos θ, a polynomial in sin θ times cos^(m-1) θ. The flows are smooth and
do not depend on the mesh; a seed gives the same flow on every machine.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from swe_sphere.equations.effects import DYNAMICS, Hyperviscosity
from swe_sphere.equations.scene import Array, Scene
from swe_sphere.errors import ConfigError
from swe_sphere.planet import EARTH, Planet
from swe_sphere.testcases.flows import ROTATING, build_scene

Complex = NDArray[np.complex128]
CHUNK = 4096
"""Number of points evaluated together: it bounds the memory for each degree."""


def synthesis(coefficients: Complex, lon: Array, lat: Array) -> tuple[Array, Array, Array]:
    """Return fields and their derivatives ∂/∂λ / cos θ and ∂/∂θ [rad-1] at points [rad].

    coefficients: those of one field (L+1, L+1), or of k fields (k, L+1, L+1). With k fields each of
    the three results has the leading dimension k, and the call takes less time than k calls.
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
    """Return values and both derivatives, (3, k, points), of k fields at points (points,)."""
    cos, sine, total = np.cos(lat), np.sin(lat), np.zeros((3, len(coefficients), len(lat)))
    used: NDArray[np.bool_] = np.asarray(coefficients.any(axis=(0, 1)))
    used[1:2] |= used[:1]  # P_n1 is needed for slopes of P_n0, below
    for m, q in enumerate(_orders(coefficients.shape[1] - 1, lat, used)):
        if not used[m]:
            continue
        c, n = coefficients[:, m:, m], np.arange(m, coefficients.shape[1])
        # coefficient of each P_n in the sum Σ c_n √((n² - m²) (2n + 1)/(2n - 1)) P_(n-1)
        lower = np.zeros_like(c)
        back = np.sqrt((n**2 - m**2) * (2.0 * n + 1.0) / np.abs(2.0 * n - 1.0))
        lower[:, :-1] = (back * c)[:, 1:]
        left = np.stack([c, n * c, lower])
        products = np.concatenate([left.real, left.imag]) @ q  # avoids a complex copy of q
        value, sloped, shifted = products[:3] + 1j * products[3:]
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


def _orders(degree: int, lat: Array, wanted: NDArray[np.bool_] | None = None) -> Iterator[Array]:
    """Yield P_n0, then P_nm / cos θ for m = 1, 2, …, each (degree + 1 - m, points).

    wanted (degree + 1,): flags of the orders to compute; the arrays of other orders are empty.
    """
    sine, cos, start = np.sin(lat), np.cos(lat), np.full_like(lat, np.sqrt(1.5))
    tops = np.full(degree + 1, degree) if wanted is None else np.where(wanted, degree, -1)
    yield _column(tops[0], 0, sine, np.ones_like(lat))
    for m in range(1, degree + 1):
        yield _column(tops[m], m, sine, start)
        start = np.sqrt((2 * m + 3) / (2 * m + 2)) * cos * start


def _column(degree: int, m: int, sine: Array, start: Array) -> Array:
    """Return P_nm for n = m … degree (rows), times the ratio of `start` to P_mm (points,)."""
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
    """Yield P_nm, P_nm / cos θ (zero for m = 0) and dP_nm/dθ at latitudes [rad] for m = 0, 1, ….

    Each array has the shape (degree + 1 - m, points), for n = m … degree.
    """
    sine, cos = np.sin(lat), np.cos(lat)
    orders = _orders(degree, lat)
    zonal, first = next(orders), next(orders, np.empty((0, len(lat))))
    n = np.arange(1, degree + 1)[:, None]
    slope = np.concatenate([0.0 * zonal[:1], np.sqrt(n * (n + 1.0)) * cos * first])
    yield zonal, 0.0 * zonal, slope
    for m, q in enumerate(chain([first], orders) if degree else orders, start=1):
        n = np.arange(m, degree + 1)[:, None]
        slope = -n * sine * q
        slope[1:] += np.sqrt((n**2 - m**2) * (2.0 * n + 1.0) / (2.0 * n - 1.0))[1:] * q[:-1]
        yield cos * q, q, slope


@dataclass(frozen=True)
class GaussGrid:
    """Points of a Gauss quadrature that is exact for products of two fields up to `degree`.

    degree: highest degree of the fields, and of the coefficients that the methods return.
    """

    degree: int

    @property
    def points(self) -> tuple[Array, Array]:
        """Longitudes and latitudes [rad], each (latitudes, longitudes)."""
        sine, _ = np.polynomial.legendre.leggauss(self.degree + 1)
        count = 2 * self.degree + 2
        return np.meshgrid(2.0 * np.pi * np.arange(count) / count, np.arcsin(sine))

    def coefficients(self, field: Array) -> Complex:
        """Return the coefficients (degree + 1, degree + 1) of a field on the grid."""
        still = np.zeros_like(field)
        return self._projected(field, still, still)

    def against_gradients(self, east: Array, north: Array) -> Complex:
        """Return the coefficients of -∇·F on the unit sphere for F = (east, north) on the grid."""
        return self._projected(np.zeros_like(east), east, north)

    def _projected(self, field: Array, east: Array, north: Array) -> Complex:
        """Return means over the sphere of field Y* + F·∇Y*, doubled for m > 0."""
        sine, weights = np.polynomial.legendre.leggauss(self.degree + 1)
        lat, found = np.arcsin(sine), np.zeros((self.degree + 1,) * 2, dtype=np.complex128)
        waves = [np.fft.fft(f, axis=1, norm="forward") for f in (field, east, north)]
        for m, (polynomial, over_cos, slope) in enumerate(legendre(self.degree, lat)):
            value, along, across = (0.5 * weights * wave[:, m] for wave in waves)
            mean = polynomial @ value - 1j * m * (over_cos @ along) + slope @ across
            found[m:, m] = mean * (2.0 if m else 1.0)
        return found


@dataclass(frozen=True)
class BalancedFlow:
    """The wind k×∇ψ, with a depth for which the divergence has no initial tendency.

    The depth solves the balance equation (Charney 1955) g ∇²h = ∇·((ζ + f) ∇ψ) - ∇²|v|²/2, or its
    linear form g ∇²h = ∇·(f ∇ψ).

    streamfunction: coefficients of ψ [m2 s-1]. planet: radius, gravity and rotation. depth: mean
    depth [m]. linear: use the linear form.
    """

    streamfunction: Complex
    planet: Planet
    depth: float
    linear: bool = False

    def state(self, lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        """Return eastward wind, northward wind [m s-1] and depth [m] at points [rad]."""
        height = self.height
        streamfunction = np.pad(self.streamfunction, (0, len(height) - len(self.streamfunction)))
        value, east, north = synthesis(np.stack([height, streamfunction]), lon, lat)
        return -north[1] / self.planet.radius, east[1] / self.planet.radius, value[0]

    @cached_property
    def height(self) -> Complex:
        """Coefficients of the depth [m], up to a degree beyond which they vanish."""
        degree = len(self.streamfunction) - 1
        grid = GaussGrid(degree + 1 if self.linear else 2 * degree + 1)
        lon, lat = grid.points
        _, east, north = synthesis(self.streamfunction, lon, lat)
        u, v = -north / self.planet.radius, east / self.planet.radius
        absolute_vorticity = 2.0 * self.planet.rotation * np.sin(lat)
        if not self.linear:
            n = np.arange(degree + 1)[:, None]
            vorticity = -n * (n + 1) * self.streamfunction / self.planet.radius**2
            absolute_vorticity = absolute_vorticity + synthesis(vorticity, lon, lat)[0]
        # ∇ψ is (v, -u)
        inflow = grid.against_gradients(absolute_vorticity * v, -absolute_vorticity * u)
        geopotential = inverse_laplacian(-inflow) * self.planet.radius
        if not self.linear:
            geopotential -= grid.coefficients(0.5 * (u**2 + v**2))
        found = geopotential / self.planet.gravity
        found[0, 0] = self.depth
        return found


def random_streamfunction(
    spectrum: Callable[[Array], Array], degree: int, speed: float, radius: float, seed: int
) -> Complex:
    """Return coefficients of ψ [m2 s-1] with a given spectrum of kinetic energy and random phases.

    spectrum: function of the degrees (k,) that returns their energies (k,), up to a factor. degree:
    highest degree; the lowest is 2, because degree 1 has angular momentum. speed: root mean square
    of the wind [m s-1]. radius: radius of the planet [m]. seed: seed of the random phases.

    Raises ConfigError for a negative seed.
    """
    if seed < 0:
        raise ConfigError(f"scene.seed must not be negative, got {seed}")
    draw = np.random.Generator(np.random.PCG64(seed)).standard_normal
    found = np.zeros((degree + 1, degree + 1), dtype=np.complex128)
    for n in range(2, degree + 1):
        row = draw((n + 1, 2)) @ np.array([1.0, 1.0j])
        row[0] = np.sqrt(2.0) * row[0].real
        found[n, : n + 1] = row
    degrees = np.arange(2.0, degree + 1.0)
    wanted = spectrum(degrees)
    wanted = 0.5 * speed**2 * wanted / wanted.sum()
    # the mean of |v|²/2
    energy = 0.5 * degrees * (degrees + 1.0) / radius**2 * mean_squares(found)[2:]
    found[2:] *= np.sqrt(wanted / energy)[:, None]
    return found


def mean_squares(coefficients: Complex) -> Array:
    """Return the mean square of a field over the sphere for each degree."""
    weights = np.where(np.arange(len(coefficients)) == 0, 1.0, 0.5)  # the mean of cos² m λ
    return np.asarray(np.abs(coefficients) ** 2 @ weights)


def inverse_laplacian(coefficients: Complex) -> Complex:
    """Return the coefficients of ∇⁻² of a field on the unit sphere, with mean zero."""
    n = np.arange(len(coefficients))[:, None]
    return coefficients / np.where(n > 0, -n * (n + 1.0), np.inf)


def turbulence(
    rotating: bool = True, speed: float = 20.0, wavenumber: int = 10, seed: int = 1
) -> Scene:
    """Decaying turbulence from a random balanced flow.

    The wind has no divergence and random phases; its kinetic energy at degree n of the spherical
    harmonics is proportional to

        E(n) ~ n^(γ/2) / (n + n0)^γ,  γ = 100,  2 ≤ n ≤ 3 n0

    with its peak at n0. The depth, 10 km in the mean, gives the divergence no initial tendency
    (nonlinear balance). Without rotation vortices merge; with rotation jets form. Hyperviscosity
    of 30 times the default coefficient of the mesh removes grid-scale enstrophy.

    Args:
        rotating: include the Coriolis force of the Earth.
        speed: root mean square of the initial wind [m s-1].
        wavenumber: n0, the degree of the energy's peak; 2 to 40.
        seed: seed of the random phases; a seed gives the same flow on every mesh.

    Raises ConfigError for a parameter out of range; `initial`, if 10 km cannot balance it.
    """
    if not 2 <= wavenumber <= 40:
        raise ConfigError(f"turbulence: wavenumber must be 2 to 40, got {wavenumber}")
    if not speed > 0.0:
        raise ConfigError(f"turbulence: speed must be positive, got {speed}")

    def spectrum(n: Array) -> Array:
        return np.asarray((np.sqrt(4.0 * n * wavenumber) / (n + wavenumber)) ** 100)  # 1 at n0

    planet = EARTH if rotating else Planet(EARTH.radius, EARTH.gravity, 0.0)
    streamfunction = random_streamfunction(spectrum, 3 * wavenumber, speed, EARTH.radius, seed)
    flow = BalancedFlow(streamfunction, planet, 1e4)

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        u, v, depth = flow.state(lon, lat)
        if depth.min() <= 0.0:
            raise ConfigError(
                f"turbulence: a mean depth of 10 km cannot balance {speed:g} m/s: reduce it"
            )
        return u, v, depth

    effects = (*(ROTATING if rotating else DYNAMICS), Hyperviscosity(factor=30.0))
    return build_scene("turbulence", effects=effects, initial=initial, planet=planet)
