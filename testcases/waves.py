"""Waves on an ocean that covers the globe: tides, planetary waves, normal and equatorial modes.

The equations of a layer of depth H on the rotating sphere, linearised about rest, are

    ∂v/∂t + f k×v = -g ∇(η - η_eq),  ∂η/∂t + H ∇·v = 0.

For one zonal wavenumber m and one frequency σ, v = ∇χ + k×∇ψ and η are sums of spherical harmonics.
Without η_eq, σ is an eigenvalue of a matrix that acts on their coefficients, and the eigenvectors
are Hough functions. An equilibrium tide η_eq leads to a linear system with this matrix. Source, in
other variables: Longuet-Higgins (1968), Phil. Trans. R. Soc. A 262, doi:10.1098/rsta.1968.0003.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from swe_sphere.equations.effects import Effect, Forcing, LinearisedDynamics
from swe_sphere.equations.scene import Array, Scene
from swe_sphere.errors import ConfigError
from swe_sphere.planet import DAY, EARTH, Planet
from swe_sphere.testcases.flows import ROTATING, at_rest, build_scene
from swe_sphere.testcases.harmonics import Complex, GaussGrid, synthesis

TIDES = {
    "m2": (2, 0.242334, 1.405189e-4), "s2": (2, 0.112743, 1.454441e-4),
    "k1": (1, 0.141565, 7.292117e-5), "o1": (1, 0.100661, 6.759774e-5),
}  # fmt: skip
"""Highs per circle of latitude, amplitude A [m] and frequency ω [s-1] by constituent.

The values are those of Arbic et al. (2004) for a rigid Earth.
"""


def _about_rest(depth: float, linear: bool, *more: Effect) -> dict[str, Any]:
    """Return the effects of a scene and, if it is linearised, its base at rest with a depth [m]."""
    effects = (*ROTATING, *more)
    if not linear:
        return {"effects": effects}
    return {"effects": (*effects, LinearisedDynamics()), "base": at_rest(depth)}


def tide(
    constituent: Literal["m2", "s2", "k1", "o1"] = "m2", depth: float = 4000.0, linear: bool = True
) -> Scene:
    """Tide in an ocean of even depth over the whole globe (exact).

    The wind is driven by g ∇η_eq, the equilibrium tide of one constituent:

        η_eq = A cos² θ cos(2 λ + ω t)  (m2, s2),  η_eq = A sin 2θ cos(λ + ω t)  (k1, o1)

    The initial state is the periodic response, a series of spherical harmonics that is exact to
    round-off. In 4 km of water the m2 tide is inverted: the water under the Moon is 0.46 m low at
    the equator, where the equilibrium tide is 0.24 m high. The k1 tide, whose period is one
    rotation of the Earth, has currents but no elevation (Laplace). Here its elevation is 3e-5 of
    the equilibrium tide, because ω is given to 7 digits and Ω to 4.

    Args:
        constituent: m2 or s2 (two highs a day), k1 or o1 (one high a day).
        depth: depth of the water at rest [m], 1000 to 1e6.
        linear: use the equations linearised about rest. In the full equations the tide is not
            exact; its relative error is about elevation over depth.

    Raises ConfigError for a depth out of range.
    """
    if not 1e3 <= depth <= 1e6:
        raise ConfigError(f"tide: depth must be 1000 m to 1e6 m, got {depth}")
    cycles, amplitude, frequency = TIDES[constituent]
    # coefficients of the normalised harmonics of degrees m, m + 1, …: only degree two contributes
    equilibrium = np.array([0.0, amplitude / np.sqrt(15.0 / 8.0)])[cycles - 1 :]
    response = TidalEquations(cycles, depth, EARTH).forced(-frequency, equilibrium)

    def forcing(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        phase = cycles * lon + frequency * t
        sine, cos = np.sin(lat), np.cos(lat)
        if cycles == 2:
            along, across = 2.0 * cos, -2.0 * sine * cos
        else:
            along, across = 2.0 * sine, 2.0 * np.cos(2.0 * lat)
        scale = EARTH.gravity / EARTH.radius
        east, north = -amplitude * along * np.sin(phase), amplitude * across * np.cos(phase)
        return scale * east, scale * north, 0.0 * lat

    return build_scene(
        "tide", title=f"{constituent.upper()} tide in an ocean of {depth:g} m",
        exact=response.state, forcing=forcing, **_about_rest(depth, linear, Forcing()),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class HoughWave:
    """A wave (ψ, χ, η) of frequency σ over a layer of depth H at rest.

    frequency: σ [s-1], negative for westward waves. coefficients (3, L+1, L+1): those of ψ, χ
    [m2 s-1] and η [m] at t = 0, as in `swe_sphere.testcases.harmonics`. depth: H [m].
    """

    frequency: float
    coefficients: Complex
    depth: float
    planet: Planet

    def state(self, lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        """Return eastward wind, northward wind [m s-1] and depth [m] at points [rad] and t [s]."""
        now = self.coefficients * np.exp(-1j * self.frequency * t)
        value, east, north = synthesis(now, lon, lat)
        u, v = east[1] - north[0], north[1] + east[0]
        return u / self.planet.radius, v / self.planet.radius, self.depth + value[2]


@dataclass(frozen=True)
class TidalEquations:
    """The equations of this module for zonal wavenumber m ≥ 1 and depth H [m]; χ is i X, X real."""

    m: int
    depth: float
    planet: Planet
    degrees: int = 32
    """Number of harmonics of each field; for depths of kilometres the last is below round-off."""

    def forced(self, frequency: float, equilibrium: Array) -> HoughWave:
        """Return the periodic response to an equilibrium tide of frequency σ [s-1].

        equilibrium: coefficients [m] of η_eq for the degrees m, m + 1, ….
        """
        force = np.zeros((3, self.degrees))
        force[1, : len(equilibrium)] = self.planet.gravity * equilibrium
        solution = np.linalg.solve(frequency * np.eye(force.size) - self._matrix, force.ravel())
        return self._wave(frequency, np.asarray(solution, dtype=np.float64))

    def free(self, n: int) -> HoughWave:
        """Return the planetary (Rossby) wave whose wind is mostly rotational and of degree n.

        Its frequency is close to -2 Ω m / (n (n + 1)); its amplitude is arbitrary.
        """
        values, vectors = np.linalg.eig(self._matrix)
        parts = vectors.real.reshape(3, self.degrees, -1)
        energy = np.sum(self._squares * parts[:2] ** 2, axis=(0, 1))
        wave = int(np.argmax(n * (n + 1) * parts[0, n - self.m] ** 2 / energy))
        return self._wave(float(values[wave].real), vectors.real[:, wave])

    def mode(self, place: int) -> HoughWave:
        """Return the free wave at index `place` of all waves, sorted by frequency.

        The first third of the waves are westward gravity waves, the second third planetary waves,
        and the last third the Kelvin wave and eastward gravity waves. The amplitude is arbitrary.
        """
        scale = np.repeat(np.sqrt(self._squares.T), 2, axis=0).ravel()
        thin = self.planet.radius * np.sqrt(self.planet.gravity / self.depth)
        scale = np.append(scale, np.full(self.degrees, thin))
        # in the norm of energy the matrix is symmetric
        values, vectors = np.linalg.eigh(scale[:, None] * self._matrix / scale)
        return self._wave(float(values[place]), vectors[:, place] / scale)

    @property
    def _squares(self) -> Array:
        """Column of n (n + 1) for the degrees n = m, m + 1, …."""
        n = self.m + np.arange(self.degrees, dtype=np.float64)
        return (n * (n + 1.0))[:, None]

    @property
    def _matrix(self) -> Array:
        """Matrix M of free waves, σ (ψ, X, η) = M (ψ, X, η); fields have degrees m, m + 1, …."""
        n = self.m + np.arange(self.degrees)
        total, two_omega = self._squares[:, 0], 2.0 * self.planet.rotation
        east = np.diag(-two_omega * self.m / total)
        # ∇·(f ∇Y_n) contains the degrees above and below
        share = np.sqrt((n**2 - self.m**2) / (4.0 * n**2 - 1.0))
        up = np.diag((-n * (n + 2.0))[:-1] * share[1:], -1)
        down = np.diag((-(n - 1.0) * (n + 1.0) * share)[1:], 1)
        across = two_omega * (up + down) / total[:, None]
        none, gravity = np.zeros_like(east), self.planet.gravity * np.eye(self.degrees)
        swelling = np.diag(-self.depth * total / self.planet.radius**2)
        return np.block([[east, -across, none], [-across, east, -gravity], [none, swelling, none]])

    def _wave(self, frequency: float, solution: Array) -> HoughWave:
        rows = solution.reshape(3, self.degrees) * np.array([1.0, 1.0j, 1.0])[:, None]
        found = np.zeros((3, self.m + self.degrees, self.m + self.degrees), dtype=np.complex128)
        found[:, self.m :, self.m] = rows
        return HoughWave(frequency, found, self.depth, self.planet)


def slow_ocean(m: int = 4, n: int = 10, speed: float = 0.1, linear: bool = False) -> Scene:
    """Planetary wave in a deep ocean, at a Froude number of 5e-4.

    The flow is a Rossby wave of Laplace's tidal equations over 4 km of water, with m waves around
    the globe and most of the currents in the spherical harmonics of degree n. Gravity waves are
    2000 times faster than the currents and 25 times faster than the Rossby wave at the equator.
    They limit the steps of explicit steppers although the flow contains none.

    The wave is exact for the equations linearised about rest. In the full equations, advection of
    the wave by itself changes the currents by a relative 3e-4 (l2) in four days at 0.1 m/s.

    Args:
        m: number of waves around the globe, 1 to 50.
        n: degree of the harmonics that contain most of the currents, from m to m + 12.
        speed: speed of the strongest current [m s-1], at most 10.
        linear: use the equations linearised about rest, for which the wave is exact.

    Raises ConfigError for a wave that does not exist, and for a speed out of range.
    """
    if not 1 <= m <= 50 or not m <= n <= m + 12:  # its series is then right to round-off
        raise ConfigError(f"slow-ocean: m must be 1 to 50 and n m to m + 12, got {m} and {n}")
    if not 0.0 < speed <= 10.0:
        raise ConfigError(f"slow-ocean: speed must be above 0 and at most 10 m/s, got {speed:g}")
    wave = TidalEquations(m, 4000.0, EARTH).free(n)
    u, v, _ = wave.state(*GaussGrid(64).points, 0.0)
    wave = replace(wave, coefficients=speed / float(np.hypot(u, v).max()) * wave.coefficients)

    return build_scene(
        "slow-ocean", title=f"planetary wave in a deep ocean (m = {m}, n = {n})",
        initial=lambda lon, lat: wave.state(lon, lat, 0.0), exact=wave.state if linear else None,
        **_about_rest(wave.depth, linear),
    )  # fmt: skip


Wave = Literal["kelvin", "rossby", "eastward", "westward"]
FUNCTIONS = 160
"""Number of harmonics of each field of a normal mode; for n = 1 they suffice at a depth of 1 m."""


def hough(
    wave: Wave = "rossby", k: int = 1, n: int = 1, depth: float = 1000.0, amplitude: float = 1.0,
    linear: bool = True,
) -> Scene:  # fmt: skip
    """Normal mode of the sphere: a Kelvin, Rossby or gravity wave (exact).

    Streamfunction, velocity potential and geopotential are sums of spherical harmonics of zonal
    wavenumber k. The equations linearised about rest (`TidalEquations`) then become a symmetric
    eigenvalue problem (Swarztrauber & Kasahara 1985, doi:10.1137/0906033), whose eigenvalues are
    the frequencies. The pattern keeps its shape; the recommended length of the run is one period.

    Args:
        wave: "kelvin", "rossby", or gravity wave "eastward" or "westward".
        k: zonal wavenumber, 1 to 500.
        n: mode, 1 to 40 (kelvin: 1), from the fastest rossby and the slowest gravity wave on. For
            rossby and eastward it is 1 + n of `matsuno`; rossby 1 is the mixed one.
        depth: mean depth [m], 1e-3 to 1e6.
        amplitude: root mean square of the wind [m s-1].
        linear: use the equations linearised about rest, for which the mode is exact.

    Raises ConfigError for a mode that does not exist, or whose series does not converge.
    """
    if not 1 <= k <= 500 or not 1 <= n <= FUNCTIONS // 4 or (wave == "kelvin" and n != 1):
        raise ConfigError(
            f"hough: k must be 1 to 500 and n 1 to {FUNCTIONS // 4} (1 for kelvin), got {k} and {n}"
        )
    if not 1e-3 <= depth <= 1e6:  # round-off hides the waves in deeper water
        raise ConfigError(f"hough: depth must be 1e-3 to 1e6 m, got {depth:g} m")
    mode = hough_wave(wave, k, n, depth, amplitude)
    return build_scene(
        "hough", title=f"normal mode of the sphere ({TITLES[wave]} wave, k = {k}, n = {n})",
        initial=lambda lon, lat: mode.state(lon, lat, 0.0), exact=mode.state if linear else None,
        days=_period(mode.frequency, 3), **_about_rest(depth, linear),
    )  # fmt: skip


def _period(frequency: float, digits: int) -> float:
    """Return the period [days] of a frequency [s-1], short ones to three significant digits."""
    days = 2.0 * np.pi / abs(frequency) / DAY
    return round(days, digits) if days > 0.1 else float(f"{days:.3g}")


def hough_wave(wave: Wave, k: int, n: int, depth: float, amplitude: float) -> HoughWave:
    """Return a normal mode; the arguments are those of `hough`."""
    place = {
        "westward": FUNCTIONS - n, "rossby": FUNCTIONS + n - 1, "kelvin": 2 * FUNCTIONS,
        "eastward": 2 * FUNCTIONS + n,
    }[wave]  # fmt: skip
    found = TidalEquations(k, depth, EARTH, FUNCTIONS).mode(place)
    sizes = np.abs(found.coefficients).max(axis=2)
    if np.any(sizes[:, -3:].max(axis=1) > 1e-8 * sizes.max(axis=1)):
        raise ConfigError(
            f"hough: {FUNCTIONS} harmonics do not resolve this mode: take a smaller k or n,"
            f" or another depth than {depth:g} m"
        )
    degree = np.arange(k + FUNCTIONS)[:, None]
    square = 0.5 * np.sum(degree * (degree + 1) * np.abs(found.coefficients[:2]) ** 2)
    factor = amplitude * EARTH.radius / np.sqrt(square)
    return replace(found, coefficients=factor * found.coefficients)


TITLES = {
    "kelvin": "Kelvin", "rossby": "Rossby", "eastward": "eastward gravity",
    "westward": "westward gravity", "eig": "eastward inertia-gravity",
    "wig": "westward inertia-gravity",
}  # fmt: skip
"""Words for the waves in the titles of scenes."""
EquatorialWave = Literal["rossby", "eig", "wig"]
PLANET = Planet(6371220.0, 9.80616, 7.29212e-5)
DEPTH = 30.0
"""Depth at rest of `matsuno` [m]: so thin that the waves are trapped near the equator."""


def matsuno(
    wave: EquatorialWave = "rossby", k: int = 5, n: int = 1, amplitude: float = 1e-5,
    linear: bool = True,
) -> Scene:  # fmt: skip
    """Equatorial Rossby or inertia-gravity wave (analytic, nearly exact).

    Matsuno's waves on the equatorial β-plane, mapped to the sphere with y = ε^(1/4) θ and ε = (2 Ω
    a)² / (g H) = 2935: normalised Hermite functions of y times exp(i (k λ - ω t)), where

        ω³ - (g H (k/a)² + 2 Ω (2n + 1) √(g H) / a) ω - 2 Ω g H k / a² = 0

    They solve the equations on the sphere up to terms of relative size ε^(-1/2) = 0.02 for n = 1
    and small k, so the error against them does not vanish with the mesh. The terms grow with n and
    k: at n = 40 speeds differ from those on the sphere by 14 to 42 %.

    Args:
        wave: "rossby", "eig" (eastward inertia-gravity) or "wig" (westward inertia-gravity).
        k: zonal wavenumber, 1 to 500.
        n: number of zeros of v between the poles, 1 to 40; waves of larger n reach the poles.
        amplitude: factor of the normalised northward wind [m s-1].
        linear: use the equations linearised about rest. The full equations require a tiny
            amplitude, and float64 to resolve so small a wave in the depth.

    Raises ConfigError for a mode that does not exist.
    """
    if not (1 <= k <= 500 and 1 <= n <= 40):
        raise ConfigError(f"matsuno: k must be 1 to 500 and n 1 to 40, got {k} and {n}")
    mode = EquatorialMode(wave, k, n, amplitude)

    return build_scene(
        "matsuno", title=f"equatorial wave ({TITLES[wave]}, k = {k}, n = {n})", exact=mode.state,
        planet=PLANET, days=_period(mode.frequency, 2), **_about_rest(DEPTH, linear),
    )  # fmt: skip


@dataclass(frozen=True)
class EquatorialMode:
    """One of Matsuno's waves (Shamir et al. 2019, eqs. 2-8); arguments are those of `matsuno`."""

    wave: EquatorialWave
    k: int
    n: int
    amplitude: float

    @cached_property
    def frequency(self) -> float:
        """Frequency ω [s-1]: the largest ("eig"), middle ("rossby") or smallest ("wig") root."""
        a, speed, two_omega = PLANET.radius, np.sqrt(PLANET.gravity * DEPTH), 2.0 * PLANET.rotation
        p = (speed * self.k / a) ** 2 + two_omega * (2 * self.n + 1) * speed / a
        q = two_omega * speed**2 * self.k / a**2
        angle = np.arccos(1.5 * q / p * np.sqrt(3.0 / p)) / 3.0  # three real roots (Viète)
        shift = {"eig": 0, "rossby": 1, "wig": 2}[self.wave]
        return float(2.0 * np.sqrt(p / 3.0) * np.cos(angle - 2.0 * np.pi * shift / 3.0))

    def state(self, lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        """Return eastward wind, northward wind [m s-1] and depth [m] at points [rad] and t [s]."""
        a, speed, n = PLANET.radius, np.sqrt(PLANET.gravity * DEPTH), self.n
        stretch = (2.0 * PLANET.rotation * a / speed) ** 0.5  # ε^(1/4)
        below, v, above = (self.amplitude * f for f in _hermite(n, stretch * lat))
        slope, wave = self.frequency / speed, self.k / a
        factor = stretch / (a * (slope**2 - wave**2))
        up, down = np.sqrt((n + 1) / 2.0) * above, np.sqrt(n / 2.0) * below
        u = factor * (-(slope + wave) * up - (slope - wave) * down)
        geopotential = speed * factor * (-(slope + wave) * up + (slope - wave) * down)
        # u and g h are in quadrature with v
        phase = self.k * lon - self.frequency * t
        depth = DEPTH + geopotential / PLANET.gravity * np.sin(phase)
        return u * np.sin(phase), v * np.cos(phase), depth


def _hermite(n: int, y: Array) -> tuple[Array, Array, Array]:
    """Return the normalised Hermite functions of orders n - 1, n and n + 1, n ≥ 1."""
    functions = [0.0 * y, np.pi**-0.25 * np.exp(-0.5 * y**2)]
    for m in range(n + 1):
        up = y * functions[-1] - np.sqrt(m / 2.0) * functions[-2]
        functions.append(np.sqrt(2.0 / (m + 1)) * up)
    return functions[n], functions[n + 1], functions[n + 2]
