"""Waves of Laplace's tidal equations in an ocean that covers the globe: tides, and a planetary one.

A layer of even depth on the turning sphere, linearised about rest:

    ∂v/∂t + f k×v = -g ∇(η - η_eq),  ∂η/∂t + H ∇·v = 0

For one zonal wavenumber m and one frequency, v = ∇χ + k×∇ψ and η are sums of spherical harmonics;
σ times their coefficients is a matrix times them. Its eigenvectors are Hough's functions; with an
equilibrium tide η_eq it is a linear system. Source: Longuet-Higgins (1968), Phil. Trans. R. Soc. A
262, 511-607, doi:10.1098/rsta.1968.0003, in other variables.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from swe_sphere.equations.effects import DYNAMICS, Forcing, Linearised, Rotation
from swe_sphere.equations.scene import Array, Scene
from swe_sphere.errors import ConfigError
from swe_sphere.planet import EARTH, Planet
from swe_sphere.testcases.flows import at_rest
from swe_sphere.testcases.harmonics import Complex, GaussGrid, synthesis
from swe_sphere.testcases.recommended import recommended

Constituent = Literal["m2", "s2", "k1", "o1"]


@dataclass(frozen=True)
class EquilibriumTide:
    """η_eq = A cos² θ cos(2 λ + ω t), semidiurnal, or A sin 2θ cos(λ + ω t), diurnal."""

    cycles: int
    """Highs around a circle of latitude: 1 or 2."""
    amplitude: float
    """A [m]."""
    frequency: float
    """ω [s-1]."""

    def gradient(self, lon: Array, lat: Array, t: float) -> tuple[Array, Array]:
        """∂/∂λ / cos θ and ∂/∂θ [m rad-1]."""
        phase = self.cycles * lon + self.frequency * t
        sine, cos = np.sin(lat), np.cos(lat)
        if self.cycles == 2:
            along, across = 2.0 * cos, -2.0 * sine * cos
        else:
            along, across = 2.0 * sine, 2.0 * np.cos(2.0 * lat)
        return -self.amplitude * along * np.sin(phase), self.amplitude * across * np.cos(phase)

    @property
    def coefficients(self) -> Array:
        """Of the normalised harmonics of degrees m, m + 1, …: all in degree two."""
        return np.array([0.0, self.amplitude / np.sqrt(15.0 / 8.0)])[self.cycles - 1 :]


TIDES = {
    "m2": EquilibriumTide(2, 0.242334, 1.405189e-4),
    "s2": EquilibriumTide(2, 0.112743, 1.454441e-4),
    "k1": EquilibriumTide(1, 0.141565, 7.292117e-5),
    "o1": EquilibriumTide(1, 0.100661, 6.759774e-5),
}
"""Amplitudes and frequencies as in Arbic et al. (2004), for a rigid Earth."""


@recommended(ne=4, np=8, dt=600.0, days=5.0)
def tide(constituent: Constituent = "m2", depth: float = 4000.0, linear: bool = True) -> Scene:
    """Tide in an ocean of even depth over the whole globe (exact).

    The wind is driven by g ∇η_eq, the equilibrium tide of one constituent:

        η_eq = A cos² θ cos(2 λ + ω t)  (m2, s2),  η_eq = A sin 2θ cos(λ + ω t)  (k1, o1)

    The start is the response that keeps pace with it, a series of spherical harmonics that is
    solved to round-off. The m2 tide in 4 km is inverted: low water under the Moon, 0.46 m at the
    equator where the equilibrium tide has 0.24 m above. The k1 tide, whose period is a turn of the
    Earth, has currents and no elevation, as Laplace found; here it has 3e-5 of the equilibrium's,
    as ω is given to 7 digits and Ω of these scenes to 4.

    Args:
        constituent: m2, s2 (two highs a day), k1 or o1 (one).
        depth: of the water at rest [m], 1000 to 1e6, so that the series is right to round-off.
        linear: equations linearised about rest; else the full ones, which differ by about
            elevation over depth.

    Raises:
        ConfigError: a depth out of range.
    """
    if not 1e3 <= depth <= 1e6:
        raise ConfigError(f"tide: depth must be 1000 m to 1e6 m, not {depth}")
    raised = TIDES[constituent]
    equations = TidalEquations(raised.cycles, depth, EARTH)
    response = equations.forced(-raised.frequency, raised.coefficients)

    def forcing(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        scale = EARTH.gravity / EARTH.radius
        east, north = raised.gradient(lon, lat, t)
        return scale * east, scale * north, 0.0 * lat

    return Scene(
        name="tide",
        title=f"{constituent.upper()} tide in an ocean of {depth:g} m",
        reference="Arbic, Garner, Hallberg & Simmons (2004), Deep-Sea Res. II 51, 3069-3101, "
        "doi:10.1016/j.dsr2.2004.09.014; solution after Longuet-Higgins (1968), "
        "doi:10.1098/rsta.1968.0003",
        effects=(*DYNAMICS, Rotation(), Forcing(), *((Linearised(),) if linear else ())),
        initial=lambda lon, lat: response.state(lon, lat, 0.0),
        exact=response.state,
        forcing=forcing,
        base=at_rest(depth) if linear else None,
        report="elevation and currents after ten tides; phase against the Moon",
    )


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
    degrees: int = DEGREES
    """Number of harmonics of each field: degrees m, m + 1, ...."""

    def forced(self, frequency: float, equilibrium: Array) -> HoughWave:
        """The flow that follows an equilibrium tide of that frequency [s-1].

        equilibrium: coefficients [m] of degrees m, m + 1, ….
        """
        force = np.zeros((3, self.degrees))
        force[1, : len(equilibrium)] = self.planet.gravity * equilibrium
        matrix = frequency * np.eye(3 * self.degrees) - self._matrix
        solution = np.linalg.solve(matrix, force.ravel())
        return self._wave(frequency, np.asarray(solution, dtype=np.float64))

    def free(self, n: int) -> HoughWave:
        """The planetary wave (Rossby's) whose wind is mostly rotation of degree n, unscaled.

        Its frequency is near to -2 Ω m / (n (n + 1)).
        """
        values, vectors = np.linalg.eig(self._matrix)
        parts = vectors.real.reshape(3, self.degrees, -1)
        energy = np.sum(self._squares * parts[:2] ** 2, axis=(0, 1))
        wave = int(np.argmax(n * (n + 1) * parts[0, n - self.m] ** 2 / energy))
        return self._wave(float(values[wave].real), vectors.real[:, wave])

    def mode(self, place: int) -> HoughWave:
        """Return the free wave at a place of all, sorted by frequency, unscaled.

        The first third of them are gravity waves that go west, the second third planetary waves,
        and the last third the Kelvin wave and gravity waves that go east.
        """
        scale = np.repeat(np.sqrt(self._squares.T), 2, axis=0).ravel()
        thin = self.planet.radius * np.sqrt(self.planet.gravity / self.depth)
        scale = np.append(scale, np.full(self.degrees, thin))
        # in the norm of energy the matrix is symmetric
        values, vectors = np.linalg.eigh(scale[:, None] * self._matrix / scale)
        return self._wave(float(values[place]), vectors[:, place] / scale)

    @property
    def _squares(self) -> Array:
        """n (n + 1) as a column."""
        n = self.m + np.arange(self.degrees, dtype=np.float64)
        return (n * (n + 1.0))[:, None]

    @property
    def _matrix(self) -> Array:
        """What σ times (ψ, X, η) is where nothing forces; each of degrees m, m + 1, …."""
        n = self.m + np.arange(self.degrees)
        total, spin = self._squares[:, 0], 2.0 * self.planet.rotation
        east = np.diag(-spin * self.m / total)
        # ∇·(f ∇Y_n) is made of the degrees above and below
        share = np.sqrt((n**2 - self.m**2) / (4.0 * n**2 - 1.0))
        up = np.diag((-n * (n + 2.0))[:-1] * share[1:], -1)
        down = np.diag((-(n - 1.0) * (n + 1.0) * share)[1:], 1)
        across = spin * (up + down) / total[:, None]
        none, gravity = np.zeros_like(east), self.planet.gravity * np.eye(self.degrees)
        swelling = np.diag(-self.depth * total / self.planet.radius**2)
        return np.block([[east, -across, none], [-across, east, -gravity], [none, swelling, none]])

    def _wave(self, frequency: float, solution: Array) -> HoughWave:
        rows = solution.reshape(3, self.degrees) * np.array([1.0, 1.0j, 1.0])[:, None]
        found = np.zeros((3, self.m + self.degrees, self.m + self.degrees), dtype=np.complex128)
        found[:, self.m :, self.m] = rows
        return HoughWave(frequency, found, self.depth, self.planet)


DEPTH = 4000.0
"""Of the water at rest [m]: gravity waves run at 198 m/s."""
HIGHEST = 12
"""Of n - m, so that the series of the wave is right to round-off."""


@recommended(ne=8, np=6, dt=600.0, days=15.0)
def slow_ocean(m: int = 4, n: int = 10, speed: float = 0.1, linear: bool = False) -> Scene:
    """Planetary wave in a deep ocean, at a Froude number of 5e-4.

    A Rossby wave of Laplace's tidal equations over 4 km of water: m waves around the globe, most of
    the currents in the spherical harmonics of degree n. Gravity waves are two thousand times
    faster than the currents and thirty times faster than the wave: explicit steps are bound by
    what does not happen.

    It is exact for the equations linearised about rest. In the full ones the wave also carries
    itself: four days at 0.1 m/s change the currents by 3e-4 of them (l2).

    Args:
        m: waves around the globe, at least 1.
        n: degree, from m to m + 12.
        speed: of the strongest current [m s-1].
        linear: equations linearised about rest, for which the wave is exact.

    Raises:
        ConfigError: a wave that there is not, or a speed that is not positive.
    """
    if not 1 <= m <= n <= m + HIGHEST:
        raise ConfigError(f"slow-ocean: m must be at least 1 and n m to m + 12, not {m} and {n}")
    if not 0.0 < speed <= 10.0:
        raise ConfigError(f"slow-ocean: speed must be above 0 and at most 10 m/s, not {speed:g}")
    wave = TidalEquations(m, DEPTH, EARTH).free(n)
    u, v, _ = wave.state(*GaussGrid(64).points, 0.0)
    factor = speed / float(np.hypot(u, v).max())
    wave = replace(wave, coefficients=factor * wave.coefficients)

    return Scene(
        name="slow-ocean",
        title=f"planetary wave in a deep ocean (m = {m}, n = {n})",
        reference="Longuet-Higgins (1968), Phil. Trans. R. Soc. A 262, 511-607, "
        "doi:10.1098/rsta.1968.0003",
        effects=(*DYNAMICS, Rotation(), *((Linearised(),) if linear else ())),
        initial=lambda lon, lat: wave.state(lon, lat, 0.0),
        exact=wave.state if linear else None,
        base=at_rest(DEPTH) if linear else None,
        report="speed of the wave; gravity waves that a step too long leaves out or lets loose",
    )
