"""Planetary constants, the same for every Williamson scene."""

from dataclasses import dataclass

import numpy as np

from swe_sphere.arrays import Array

HOUR = 3600.0
"""One hour [s]."""

DAY = 86400.0
"""One day [s]."""


@dataclass(frozen=True)
class Planet:
    """Radius [m], gravity [m s-2] and angular speed [s-1] of the planet.

    The defaults are those of Williamson et al. (1992), doi:10.1016/S0021-9991(05)80016-6.
    """

    radius: float = 6.37122e6
    gravity: float = 9.80616
    rotation: float = 7.292e-5

    def coriolis(self, lon: Array, lat: Array) -> Array:
        """Return the Coriolis parameter f = 2 Ω sin θ [s-1] at points [rad]."""
        return 2.0 * self.rotation * np.sin(lat) + 0.0 * lon


EARTH = Planet()
