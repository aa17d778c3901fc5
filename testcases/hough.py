"""Normal modes of a layer on the turning sphere (Hough modes)."""

from dataclasses import replace
from typing import Literal

import numpy as np

from swe_sphere.equations.effects import DYNAMICS, Linearised, Rotation
from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
from swe_sphere.planet import DAY, EARTH
from swe_sphere.testcases.flows import at_rest
from swe_sphere.testcases.recommended import recommended
from swe_sphere.testcases.tide import HoughWave, TidalEquations

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
    wavenumber k. The equations linearised about rest (`TidalEquations`) then become a symmetric
    eigenvalue problem (Swarztrauber & Kasahara 1985, doi:10.1137/0906033), whose eigenvalues are
    the frequencies. The pattern goes around the planet without changing its shape.

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
    mode = hough_wave(wave, k, n, depth, amplitude)
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


def hough_wave(wave: Wave, k: int, n: int, depth: float, amplitude: float) -> HoughWave:
    """Return a normal mode; arguments as for `hough`."""
    place = {
        "westward": FUNCTIONS - n,
        "rossby": FUNCTIONS + n - 1,
        "kelvin": 2 * FUNCTIONS,
        "eastward": 2 * FUNCTIONS + n,
    }[wave]
    found = TidalEquations(k, depth, EARTH, FUNCTIONS).mode(place)
    degree = np.arange(k + FUNCTIONS)[:, None]
    square = 0.5 * np.sum(degree * (degree + 1) * np.abs(found.coefficients[:2]) ** 2)
    factor = amplitude * EARTH.radius / np.sqrt(square)
    return replace(found, coefficients=factor * found.coefficients)
