"""Case 3 of Williamson et al. (1992): a steady jet of compact support about a tilted axis."""

from __future__ import annotations

import numpy as np

from swe_sphere.equations.effects import DYNAMICS, Rotation
from swe_sphere.equations.scene import Array, Scene
from swe_sphere.planet import EARTH
from swe_sphere.testcases.formulas import solid_body, tilted_latitude
from swe_sphere.testcases.williamson import PAPER, SPEED
from swe_sphere.testcases.zonal import ZonalBalance

__all__ = ["williamson3"]

SOUTH, NORTH = -np.pi / 6.0, np.pi / 2.0
"""The jet blows between these latitudes of its own axis [rad]."""
EDGE = 0.3
"""The constant x_e of the paper."""


def williamson3(alpha: float = 0.0) -> Scene:
    """Steady jet of compact support in geostrophic balance (exact).

    Case 3. With θ' the latitude above the equator of the axis tilted by α, x = 0.3 (θ' + π/6) /
    (2π/3) and b(x) = exp(-1/x) for x > 0, 0 elsewhere,

        u' = u0 b(x) b(0.3 - x) exp(4/0.3),  g h = g h0 - ∫ (2 Ω a sin θ' + u' tan θ') u' dθ'

    The largest wind, u0 = 2 π a / 12 days, is at θ' = π/6. Infinitely smooth, but not analytic at
    the rims of the jet: spectral convergence sets in late.

    Args:
        alpha: tilt of the axis of flow and of rotation [rad]; 0 and π/3 in the paper.
    """

    def exact(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        sine = np.clip(tilted_latitude(lon, lat, alpha), -1.0, 1.0)
        east, north = solid_body(lon, lat, alpha)
        around = np.hypot(east, north)  # cosine of the tilted latitude
        latitude = np.arctan2(sine, around)
        turning = jet(latitude) / np.where(around > 0.0, around, 1.0)
        depth = (2.94e4 - BALANCE.drop(latitude)) / EARTH.gravity
        return turning * east, turning * north, depth

    return Scene(
        name="williamson3",
        title="steady jet of compact support",
        reference=f"{PAPER}, case 3",
        effects=(*DYNAMICS, Rotation()),
        initial=lambda lon, lat: exact(lon, lat, 0.0),
        exact=exact,
        coriolis=lambda lon, lat: 2.0 * EARTH.rotation * tilted_latitude(lon, lat, alpha),
        report="l1, l2, linf of h and of the wind after 5 days",
        ne=8,
        np=8,
        dt=300.0,
        days=5.0,
    )


def jet(latitude: Array) -> Array:
    """Wind [m s-1] along the circles of latitude [rad] of the tilted axis."""
    x = EDGE * (latitude - SOUTH) / (NORTH - SOUTH)
    inside = (x > 0.0) & (x < EDGE)
    x = np.where(inside, x, 0.5 * EDGE)
    wind = SPEED * np.exp(4.0 / EDGE - 1.0 / x - 1.0 / (EDGE - x))
    return np.where(inside, wind, 0.0)


BALANCE = ZonalBalance(jet, SOUTH, NORTH)
"""Depth in balance with the jet."""
