"""Zonal winds u(θ) of compact support, and depths in balance with a zonal wind."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from swe_sphere.equations.scene import Array
from swe_sphere.planet import EARTH, Planet

PANELS = 128
POINTS = 8
"""Gauss-Legendre panels over the wind and points a panel: the integrals are right to round-off."""


@dataclass(frozen=True)
class ZonalBalance:
    """The fall of g h from the south pole that balances a zonal wind.

    A steady zonal flow satisfies g ∂h/∂θ = -a u (f + u tan θ / a) (Williamson et al. 1992, eq. 101;
    Galewsky et al. 2004, eq. 3).

    Args:
        wind: eastward wind [m s-1] at latitudes [rad]; smooth, or smooth where it is not zero.
        south, north: the wind is zero outside of these latitudes [rad].
        planet: whose radius and rotation.
    """

    wind: Callable[[Array], Array]
    south: float = -np.pi / 2.0
    north: float = np.pi / 2.0
    planet: Planet = EARTH

    def drop(self, lat: Array | float) -> Array:
        """Fall of g h [m2 s-2] from the south pole to the latitude [rad]."""
        lat = np.asarray(lat, dtype=np.float64)
        edges, totals = self._panels
        drop = np.where(lat >= self.north, totals[-1], 0.0)
        inside = (lat > self.south) & (lat < self.north)
        panel = np.searchsorted(edges, lat[inside], side="right") - 1
        drop[inside] = totals[panel] + self._integral(edges[panel], lat[inside])
        return drop

    def _slope(self, lat: Array) -> Array:
        """a u (f + u tan θ / a) [m2 s-2 rad-1]."""
        wind, coriolis = self.wind(lat), 2.0 * self.planet.rotation * np.sin(lat)
        return wind * (self.planet.radius * coriolis + wind * np.tan(lat))

    def _integral(self, start: Array, end: Array) -> Array:
        """Integral of the slope from start to end [rad], one Gauss-Legendre panel each."""
        points, weights = np.polynomial.legendre.leggauss(POINTS)
        half = 0.5 * (end - start)
        lat = 0.5 * (start + end)[..., None] + half[..., None] * points
        return half * (self._slope(lat) @ weights)

    @cached_property
    def _panels(self) -> tuple[Array, Array]:
        """Edges of the panels [rad] and the integral from the southern rim to each."""
        edges = np.linspace(self.south, self.north, PANELS + 1)
        return edges, np.concatenate([[0.0], np.cumsum(self._integral(edges[:-1], edges[1:]))])


@dataclass(frozen=True)
class ZonalJet:
    """A wind between two latitudes, infinitely smooth but not analytic at its rims.

    u(θ) = u0 exp(s (4/w² - 1/((θ - θ0)(θ1 - θ)))) for θ0 < θ < θ1, w = θ1 - θ0; zero elsewhere.

    Args:
        speed: u0 [m s-1], the largest wind, halfway.
        south, north: θ0 and θ1 [rad].
        sharpness: s [rad2].
    """

    speed: float
    south: float
    north: float
    sharpness: float = 1.0

    def __call__(self, lat: Array) -> Array:
        """Wind [m s-1] at latitudes [rad]."""
        inside = (lat > self.south) & (lat < self.north)
        within = np.where(inside, (lat - self.south) * (self.north - lat), 1.0)
        shape = np.exp(self.sharpness * (4.0 / (self.north - self.south) ** 2 - 1.0 / within))
        return np.where(inside, self.speed * shape, 0.0)

    @cached_property
    def balance(self) -> ZonalBalance:
        """Depth in balance with the wind."""
        return ZonalBalance(self, self.south, self.north)
