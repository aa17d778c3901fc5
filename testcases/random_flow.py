"""Random flows without divergence, the depths that balance them, and how their turbulence decays.

Everything is a finite sum of spherical harmonics: smooth, the same on every mesh, and the same on
every machine for the same seed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from swe_sphere.equations.effects import DYNAMICS, Hyperviscosity, Rotation
from swe_sphere.equations.scene import Array, Scene
from swe_sphere.errors import ConfigError
from swe_sphere.planet import EARTH, Planet
from swe_sphere.testcases.flows import recommended
from swe_sphere.testcases.harmonics import Complex, GaussGrid, synthesis


@dataclass(frozen=True)
class BalancedFlow:
    """The wind k×∇ψ and a depth that keeps it free of divergence at first.

    Balance: g ∇²h = ∇·((ζ + f) ∇ψ) - ∇²|v|²/2, so that the divergence does not grow at once
    (Charney 1955; the balance equation). Linear: g ∇²h = ∇·(f ∇ψ).

    Args:
        streamfunction: coefficients of ψ [m2 s-1].
        planet: its radius, gravity and rotation.
        depth: mean depth [m].
        linear: without the nonlinear terms.
    """

    streamfunction: Complex
    planet: Planet
    depth: float
    linear: bool = False

    def state(self, lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        """Eastward wind, northward wind [m s-1] and depth [m]."""
        height = self.height
        streamfunction = np.zeros_like(height)
        streamfunction[: len(self.streamfunction), : len(self.streamfunction)] = self.streamfunction
        value, east, north = synthesis(np.stack([height, streamfunction]), lon, lat)
        return -north[1] / self.planet.radius, east[1] / self.planet.radius, value[0]

    def wind(self, lon: Array, lat: Array) -> tuple[Array, Array]:
        """Eastward and northward wind [m s-1]."""
        _, east, north = synthesis(self.streamfunction, lon, lat)
        return -north / self.planet.radius, east / self.planet.radius

    @cached_property
    def height(self) -> Complex:
        """Coefficients of the depth [m], of so high a degree that they are exact."""
        degree = len(self.streamfunction) - 1
        grid = GaussGrid(degree + 1 if self.linear else 2 * degree + 1)
        lon, lat = grid.points
        u, v = self.wind(lon, lat)
        spin = 2.0 * self.planet.rotation * np.sin(lat)
        if not self.linear:
            n = np.arange(degree + 1)[:, None]
            vorticity = -n * (n + 1) * self.streamfunction / self.planet.radius**2
            spin = spin + synthesis(vorticity, lon, lat)[0]
        # ∇ψ is (v, -u)
        flux = grid.against_gradients(spin * v, -spin * u)
        geopotential = inverse_laplacian(-flux) * self.planet.radius
        if not self.linear:
            geopotential -= grid.coefficients(0.5 * (u**2 + v**2))
        found = geopotential / self.planet.gravity
        found[0, 0] = self.depth
        return found


def random_streamfunction(
    spectrum: Callable[[Array], Array], degree: int, speed: float, radius: float, seed: int
) -> Complex:
    """Coefficients of ψ [m2 s-1] with a given spectrum of kinetic energy and random phases.

    Args:
        spectrum: energy of each degree, up to a factor.
        degree: the highest degree; the lowest is 2, so that there is no angular momentum.
        speed: root mean square of the wind [m s-1].
        radius: of the planet [m].
        seed: another one gives another flow.
    """
    draw = np.random.Generator(np.random.PCG64(seed)).standard_normal
    found = np.zeros((degree + 1, degree + 1), dtype=np.complex128)
    for n in range(2, degree + 1):
        row = draw((n + 1, 2)) @ np.array([1.0, 1.0j])
        row[0] = np.sqrt(2.0) * row[0].real
        found[n, : n + 1] = row
    wanted = spectrum(np.arange(2.0, degree + 1.0))
    wanted = 0.5 * speed**2 * wanted / wanted.sum()
    found[2:] *= np.sqrt(wanted / mean_kinetic_energy(found, radius)[2:])[:, None]
    return found


def mean_kinetic_energy(streamfunction: Complex, radius: float) -> Array:
    """Mean of |v|²/2 over the sphere [m2 s-2], degree by degree."""
    n = np.arange(len(streamfunction))
    weights = np.where(n == 0, 1.0, 0.5)
    squares: Array = np.abs(streamfunction) ** 2 @ weights
    return 0.5 * n * (n + 1) / radius**2 * squares


def inverse_laplacian(coefficients: Complex) -> Complex:
    """∇⁻² on the unit sphere; zero for the mean."""
    n = np.arange(len(coefficients))[:, None]
    return coefficients / np.where(n > 0, -n * (n + 1.0), np.inf)


@recommended(ne=30, np=4, dt=200.0, days=20.0)
def turbulence(
    rotating: bool = True, speed: float = 20.0, wavenumber: int = 10, seed: int = 1
) -> Scene:
    """Decaying turbulence from a random balanced flow.

    The wind has no divergence and random phases; its kinetic energy at degree n of the spherical
    harmonics goes as

        E(n) ~ n^(γ/2) / (n + n0)^γ,  γ = 100,  2 ≤ n ≤ 3 n0

    with its peak at n0. The depth, 10 km in the mean, keeps the divergence from growing at once
    (nonlinear balance). Without rotation vortices merge; with it jets form. Grid-scale enstrophy
    is taken out by the hyperviscosity that goes with the mesh.

    Args:
        rotating: with the Coriolis force of the Earth.
        speed: root mean square of the wind at the start [m s-1].
        wavenumber: n0, the degree of the energy's peak; 2 to 40.
        seed: of the random phases; the same flow on every mesh.

    Raises:
        ConfigError: a parameter out of range, or a wind too strong to be balanced by 10 km.
    """
    if not 2 <= wavenumber <= 40:
        raise ConfigError(f"turbulence: wavenumber must be 2 to 40, not {wavenumber}")
    if not speed > 0.0:
        raise ConfigError(f"turbulence: speed must be positive, not {speed}")
    if seed < 0:
        raise ConfigError(f"turbulence: seed must not be negative, but is {seed}")

    def spectrum(n: Array) -> Array:
        ratio: Array = np.sqrt(4.0 * n * wavenumber) / (n + wavenumber)  # 1 at the peak
        return ratio**100

    planet = EARTH if rotating else Planet(EARTH.radius, EARTH.gravity, 0.0)
    streamfunction = random_streamfunction(spectrum, 3 * wavenumber, speed, EARTH.radius, seed)
    flow = BalancedFlow(streamfunction, planet, 1e4)

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        u, v, depth = flow.state(lon, lat)
        if depth.min() <= 0.0:
            raise ConfigError(
                f"turbulence: a mean depth of 10 km cannot balance {speed:g} m/s: less"
            )
        return u, v, depth

    return Scene(
        name="turbulence",
        title="decaying turbulence",
        reference="after Cho & Polvani (1996), Phys. Fluids 8, 1531-1552, doi:10.7916/D8DJ5RSK "
        "(copy); spectrum of Yoden & Yamada (1993), J. Atmos. Sci. 50, 631-644",
        effects=(*DYNAMICS, *((Rotation(),) if rotating else ()), Hyperviscosity()),
        initial=initial,
        planet=planet,
    )
