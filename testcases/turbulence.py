"""Decaying turbulence on the sphere, from a random balanced flow."""

import numpy as np

from swe_sphere.equations.effects import DYNAMICS, Hyperviscosity, Rotation
from swe_sphere.equations.scene import Array, Scene
from swe_sphere.errors import ConfigError
from swe_sphere.planet import EARTH, Planet
from swe_sphere.testcases.flows import coriolis
from swe_sphere.testcases.harmonics import Complex
from swe_sphere.testcases.random_flow import BalancedFlow, random_streamfunction

PAPER = (
    "after Cho & Polvani (1996), Phys. Fluids 8, 1531-1552, doi:10.7916/D8DJ5RSK (copy); "
    "spectrum of Yoden & Yamada (1993), J. Atmos. Sci. 50, 631-644"
)
STEEPNESS = 100
"""γ of the spectrum: the larger, the narrower."""
DEPTH = 1e4
"""Mean depth [m]."""


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
    planet = EARTH if rotating else Planet(EARTH.radius, EARTH.gravity, 0.0)
    flow = BalancedFlow(_streamfunction(speed, wavenumber, seed), planet, DEPTH)

    return Scene(
        name="turbulence",
        title="decaying turbulence",
        reference=PAPER,
        effects=(*DYNAMICS, *((Rotation(),) if rotating else ()), Hyperviscosity()),
        initial=lambda lon, lat: _deep_enough(flow.state(lon, lat), speed),
        coriolis=coriolis if rotating else None,
        planet=planet,
        report="vorticity at days 5, 10 and 20; decay of energy and potential enstrophy",
        ne=30,
        np=4,
        dt=200.0,
        days=20.0,
    )


def _streamfunction(speed: float, wavenumber: int, seed: int) -> Complex:
    if not 2 <= wavenumber <= 40:
        raise ConfigError(f"turbulence: wavenumber must be 2 to 40, not {wavenumber}")
    if not speed > 0.0:
        raise ConfigError(f"turbulence: speed must be positive, not {speed}")
    if seed < 0:
        raise ConfigError(f"turbulence: seed must not be negative, but is {seed}")

    def spectrum(n: Array) -> Array:
        ratio: Array = np.sqrt(4.0 * n * wavenumber) / (n + wavenumber)  # 1 at the peak
        return ratio**STEEPNESS

    found: Complex = random_streamfunction(spectrum, 3 * wavenumber, speed, EARTH.radius, seed)
    return found


def _deep_enough(state: tuple[Array, Array, Array], speed: float) -> tuple[Array, Array, Array]:
    """The state, if its depth is positive everywhere."""
    if state[2].min() <= 0.0:
        raise ConfigError(f"turbulence: a mean depth of 10 km cannot balance {speed:g} m/s: less")
    return state
