"""A planetary wave in an ocean of four kilometres: currents far slower than gravity waves."""

import numpy as np

from swe_sphere.equations.effects import DYNAMICS, Linearised, Rotation
from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
from swe_sphere.planet import EARTH
from swe_sphere.testcases.flows import coriolis
from swe_sphere.testcases.harmonics import GaussGrid
from swe_sphere.testcases.tidal_equations import HoughWave, TidalEquations

DEPTH = 4000.0
"""Of the water at rest [m]: gravity waves run at 198 m/s."""
HIGHEST = 12
"""Of n - m, so that the series of the wave is right to round-off."""


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
    wave = _scaled(TidalEquations(m, DEPTH, EARTH).free(n), speed)

    return Scene(
        name="slow-ocean",
        title=f"planetary wave in a deep ocean (m = {m}, n = {n})",
        reference="Longuet-Higgins (1968), Phil. Trans. R. Soc. A 262, 511-607, "
        "doi:10.1098/rsta.1968.0003",
        effects=(*DYNAMICS, Rotation(), *((Linearised(),) if linear else ())),
        initial=lambda lon, lat: wave.state(lon, lat, 0.0),
        exact=wave.state if linear else None,
        base=(lambda lon, lat: (0.0 * lon, 0.0 * lat, DEPTH + 0.0 * lat)) if linear else None,
        coriolis=coriolis,
        report="speed of the wave; gravity waves that a step too long leaves out or lets loose",
        ne=8,
        np=6,
        dt=600.0,
        days=15.0,
    )


def _scaled(wave: HoughWave, speed: float) -> HoughWave:
    """The wave with that strongest current [m s-1]."""
    lon, lat = GaussGrid(64).points
    u, v, _ = wave.state(lon, lat, 0.0)
    factor = speed / float(np.hypot(u, v).max())
    return HoughWave(wave.frequency, factor * wave.coefficients, wave.depth, wave.planet)
