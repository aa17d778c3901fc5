"""Laplace's tidal equations: a layer of even depth on the turning sphere, linearised about rest.

    ∂v/∂t + f k×v = -g ∇(η - η_eq),  ∂η/∂t + H ∇·v = 0

For one zonal wavenumber m and one frequency, v = ∇χ + k×∇ψ and η are sums of spherical harmonics;
σ times their coefficients is a matrix times them. Its eigenvectors are Hough's functions; with an
equilibrium tide η_eq it is a linear system. Source: Longuet-Higgins (1968), Phil. Trans. R. Soc. A
262, 511-607, doi:10.1098/rsta.1968.0003, in other variables.
"""

from dataclasses import dataclass

import numpy as np

from swe_sphere.equations.scene import Array
from swe_sphere.planet import Planet
from swe_sphere.testcases.harmonics import Complex, synthesis

DEGREES = 32
"""Degrees above m: coefficients fall below round-off long before for depths of kilometres."""


@dataclass(frozen=True, eq=False)
class HoughWave:
    """The flow Re (ψ, i X, η) exp(i (m λ - σ t)) over a depth at rest H.

    frequency: σ [s-1], negative for waves that go west.  coefficients (3, L+1, L+1): of ψ, χ
    [m2 s-1] and η [m] at t = 0, as in `swe_sphere.testcases.harmonics`.
    """

    frequency: float
    coefficients: Complex
    depth: float
    planet: Planet

    def state(self, lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        """Eastward wind, northward wind [m s-1] and depth [m]."""
        now = self.coefficients * np.exp(-1j * self.frequency * t)
        value, east, north = synthesis(now, lon, lat)
        u, v = east[1] - north[0], north[1] + east[0]
        return u / self.planet.radius, v / self.planet.radius, self.depth + value[2]


@dataclass(frozen=True)
class TidalEquations:
    """The equations for zonal wavenumber m ≥ 1 over a depth at rest [m]."""

    m: int
    depth: float
    planet: Planet

    def forced(self, frequency: float, equilibrium: Array) -> HoughWave:
        """The flow that follows an equilibrium tide of that frequency [s-1].

        equilibrium: coefficients [m] of degrees m, m + 1, ….
        """
        force = np.zeros((3, DEGREES))
        force[1, : len(equilibrium)] = self.planet.gravity * equilibrium
        matrix = frequency * np.eye(3 * DEGREES) - self._matrix
        return self._wave(
            frequency, np.asarray(np.linalg.solve(matrix, force.ravel()), dtype=np.float64)
        )

    def free(self, n: int) -> HoughWave:
        """The planetary wave (Rossby's) whose wind is mostly rotation of degree n, unscaled.

        Its frequency is near to -2 Ω m / (n (n + 1)).
        """
        values, vectors = np.linalg.eig(self._matrix)
        parts = vectors.real.reshape(3, DEGREES, -1)
        energy = np.sum(self._squares * parts[:2] ** 2, axis=(0, 1))
        wave = int(np.argmax(n * (n + 1) * parts[0, n - self.m] ** 2 / energy))
        return self._wave(float(values[wave].real), vectors.real[:, wave])

    @property
    def _squares(self) -> Array:
        """n (n + 1) as a column."""
        n = self.m + np.arange(DEGREES, dtype=np.float64)
        return (n * (n + 1.0))[:, None]

    @property
    def _matrix(self) -> Array:
        """What σ times (ψ, X, η) is where nothing forces; each of degrees m, m + 1, …."""
        n = self.m + np.arange(DEGREES)
        total, spin = self._squares[:, 0], 2.0 * self.planet.rotation
        east = np.diag(-spin * self.m / total)
        # ∇·(f ∇Y_n) is made of the degrees above and below
        share = np.sqrt((n**2 - self.m**2) / (4.0 * n**2 - 1.0))
        up = np.diag((-n * (n + 2.0))[:-1] * share[1:], -1)
        down = np.diag((-(n - 1.0) * (n + 1.0) * share)[1:], 1)
        across = spin * (up + down) / total[:, None]
        none, gravity = np.zeros_like(east), self.planet.gravity * np.eye(DEGREES)
        swelling = np.diag(-self.depth * total / self.planet.radius**2)
        return np.block([[east, -across, none], [-across, east, -gravity], [none, swelling, none]])

    def _wave(self, frequency: float, solution: Array) -> HoughWave:
        rows = solution.reshape(3, DEGREES) * np.array([1.0, 1.0j, 1.0])[:, None]
        found = np.zeros((3, self.m + DEGREES, self.m + DEGREES), dtype=np.complex128)
        found[:, self.m :, self.m] = rows
        return HoughWave(frequency, found, self.depth, self.planet)
