"""Normal modes of a layer on the turning sphere (Hough modes)."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from swe_sphere.equations.effects import DYNAMICS, Linearised, Rotation
from swe_sphere.equations.scene import Array, Scene
from swe_sphere.errors import ConfigError
from swe_sphere.planet import DAY, EARTH
from swe_sphere.testcases.flows import at_rest
from swe_sphere.testcases.harmonics import Complex, synthesis
from swe_sphere.testcases.recommended import recommended

Wave = Literal["kelvin", "rossby", "eastward", "westward"]
FUNCTIONS = 160
"""Spherical harmonics of each field: modes of a layer of 1 m are right to round-off."""
NAMES = {
    "kelvin": "Kelvin wave",
    "rossby": "Rossby wave",
    "eastward": "eastward gravity wave",
    "westward": "westward gravity wave",
}


@recommended(ne=6, np=6, dt=300.0)
def hough(
    wave: Wave = "rossby",
    k: int = 1,
    n: int = 1,
    depth: float = 1000.0,
    amplitude: float = 1.0,
    linear: bool = True,
) -> Scene:
    """Normal mode of the sphere: a Kelvin, Rossby or gravity wave (exact).

    Streamfunction, velocity potential and geopotential are sums of spherical harmonics of zonal
    wavenumber k. The equations linearised about rest then become a symmetric eigenvalue problem
    (Swarztrauber & Kasahara 1985, doi:10.1137/0906033), whose eigenvalues are the frequencies. The
    pattern goes around the planet without changing its shape.

    Args:
        wave: "kelvin", "rossby", or gravity wave "eastward" or "westward".
        k: Zonal wavenumber, at least 1.
        n: Meridional mode, from 1; 1 is the fastest Rossby wave, or the slowest gravity wave.
            There is one Kelvin wave.
        depth: Mean depth [m].
        amplitude: Root mean square of the wind [m s-1].
        linear: Whether the equations are linearised about rest, so that the mode is exact.

    Raises:
        ConfigError: no such mode, or a depth that is not positive.
    """
    if k < 1 or not 1 <= n <= FUNCTIONS // 4 or (wave == "kelvin" and n != 1):
        raise ConfigError(
            f"hough: k must be at least 1 and n from 1 to {FUNCTIONS // 4} (1 for kelvin), not"
            f" {k} and {n}"
        )
    if not depth > 0.0:
        raise ConfigError(f"hough: depth must be positive, not {depth} m")
    mode = HoughMode(wave, k, n, depth, amplitude)
    return Scene(
        name="hough",
        title=f"normal mode of the sphere ({NAMES[wave]}, k = {k}, n = {n})",
        reference="Swarztrauber & Kasahara (1985), SIAM J. Sci. Stat. Comput. 6, 464-491, "
        "doi:10.1137/0906033",
        effects=(*DYNAMICS, Rotation(), *((Linearised(),) if linear else ())),
        initial=lambda lon, lat: mode.state(lon, lat, 0.0),
        exact=mode.state if linear else None,
        base=at_rest(depth) if linear else None,
        report="speed of the pattern and decay after a period",
        days=round(2.0 * np.pi / abs(mode.frequency) / DAY, 3),
    )


@dataclass(frozen=True)
class HoughMode:
    """A normal mode: frequency and fields."""

    wave: Wave
    k: int
    n: int
    depth: float
    amplitude: float

    @property
    def frequency(self) -> float:
        """Frequency [s-1]; the pattern moves eastward where it is positive."""
        return self._mode[0]

    def state(self, lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        """Return the eastward wind, the northward wind [m s-1] and the depth [m] at a time [s]."""
        frequency, coefficients = self._mode
        moved = coefficients * np.exp(-1j * frequency * t)
        (_, _, phi), east, north = synthesis(moved, lon, lat)
        u = (east[1] - north[0]) / EARTH.radius
        v = (east[0] + north[1]) / EARTH.radius
        return u, v, self.depth + phi / EARTH.gravity

    @cached_property
    def _mode(self) -> tuple[float, Complex]:
        """Frequency, and coefficients (3, L+1, L+1) of streamfunction, potential, geopotential.

        With X = i x of the velocity potential, and all fields in the norm of energy, the equations

            d zeta/dt = -div(f grad chi) - 2 Omega/a^2 dpsi/dlambda,
            d delta/dt = div(f grad psi) - 2 Omega/a^2 dchi/dlambda - lap phi,
            dphi/dt = -g H delta

        have a real symmetric matrix, as div(mu grad Y_n) couples n with n - 1 and n + 1.
        """
        k, spin, radius = self.k, 2.0 * EARTH.rotation, EARTH.radius
        degree = np.arange(k, k + FUNCTIONS)
        eigenvalue = degree * (degree + 1.0)
        after = degree[:-1] + 1.0
        couples = np.sqrt((after**2 - k**2) / (4.0 * after**2 - 1.0)) * (after**2 - 1.0)
        coriolis = spin * couples / np.sqrt(eigenvalue[:-1] * eigenvalue[1:])
        beta = np.diag(-spin * k / eigenvalue)
        waves = np.diag(-np.sqrt(EARTH.gravity * self.depth * eigenvalue) / radius)
        turning, none = np.diag(coriolis, 1) + np.diag(coriolis, -1), np.zeros_like(beta)
        frequencies, vectors = np.linalg.eigh(
            np.block([[beta, turning, none], [turning, beta, waves], [none, waves, none]])
        )
        place = {
            "westward": FUNCTIONS - self.n,
            "rossby": FUNCTIONS + self.n - 1,
            "kelvin": 2 * FUNCTIONS,
            "eastward": 2 * FUNCTIONS + self.n,
        }[self.wave]
        psi, chi, phi = vectors[:, place].reshape(3, FUNCTIONS)
        wind = np.sqrt(0.5 * np.sum(psi**2 + chi**2)) / radius
        scale = self.amplitude / wind
        found = np.zeros((3, degree[-1] + 1, degree[-1] + 1), dtype=np.complex128)
        found[0, degree, k] = scale * psi / np.sqrt(eigenvalue)
        found[1, degree, k] = 1j * scale * chi / np.sqrt(eigenvalue)
        found[2, degree, k] = scale * phi * np.sqrt(EARTH.gravity * self.depth) / radius
        return float(frequencies[place]), found
