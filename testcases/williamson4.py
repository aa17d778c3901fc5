"""Case 4 of Williamson et al. (1992): a low that a forcing carries along in a jet, exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from swe_sphere.equations.effects import DYNAMICS, Forcing, Rotation
from swe_sphere.equations.scene import Array, Scene
from swe_sphere.planet import EARTH
from swe_sphere.testcases.recommended import recommended
from swe_sphere.testcases.williamson import PAPER
from swe_sphere.testcases.zonal import ZonalBalance

DEPTH = 1e5
"""g h0 of the paper [m2 s-2]: g h at the poles."""
CENTRE = np.pi / 4.0
"""Latitude of the low [rad]."""
STRENGTH = -0.03 * DEPTH / (2.0 * EARTH.rotation * np.sin(CENTRE))
"""Streamfunction at the centre of the low [m2 s-1]."""
SHARPNESS = (2.0 * EARTH.radius / 1e6) ** 2
"""The constant σ of the paper."""
FAR = 0.4
"""Cosine of a distance at which ψ is 1e-30 of what it is at the centre."""


@recommended(ne=8, np=8, dt=150.0, days=5.0)
def williamson4(u0: float = 20.0) -> Scene:
    """Low carried along in a jet by a forcing (exact).

    Case 4. A wind ū = u0 sin¹⁴ 2θ in balance with its depth h̄, and a low in it,

        ψ = ψ0 exp(-σ (1 - C)/(1 + C)),  C the cosine of the distance from its centre,
        u = ū - ∂ψ/∂θ / a,  v = ∂ψ/∂λ / (a cos θ),  h = h̄ + f ψ / g

    whose centre moves along 45°N at the angular speed u0 / a. This solves the equations with a
    forcing of wind and depth, evaluated at the times of the stepper's stages.

    Args:
        u0: speed of the jets at 45°N and 45°S [m s-1]; 20 and 40 in the paper.
    """
    flow = _Flow(u0, ZonalBalance(lambda lat: _jet(u0, lat)))

    return Scene(
        name="williamson4",
        title="forced low in a jet",
        reference=f"{PAPER}, case 4",
        effects=(*DYNAMICS, Rotation(), Forcing()),
        initial=lambda lon, lat: flow.state(lon, lat, 0.0),
        exact=flow.state,
        forcing=flow.forcing,
        report="l1, l2, linf of h and of the wind after 5 days; depth at the centre of the low",
    )


@dataclass(frozen=True)
class _Flow:
    """The exact flow and its forcing for one speed u0 [m s-1]."""

    u0: float
    balance: ZonalBalance

    def state(self, lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        """Eastward wind, northward wind [m s-1] and depth [m]."""
        low = _Low.at(lon - self.u0 * t / EARTH.radius, lat)
        depth = DEPTH - self.balance.drop(lat) + EARTH.coriolis(lon, lat) * low.psi
        return _jet(self.u0, lat) + low.u, low.v, depth / EARTH.gravity

    def forcing(self, lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        """Forcing of the wind [m s-2], eastward and northward, and of the depth [m s-1].

        What is left of the equations when the exact flow is put in. It is zero, and not computed,
        where there is nothing of the low.
        """
        lon = lon - self.u0 * t / EARTH.radius
        there = _cosine(lon, lat) > FAR
        found = np.zeros((3, *np.shape(there)))
        found[:, there] = self._forcing(lon[there], lat[there])
        return found[0], found[1], found[2]

    def _forcing(self, lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        """The forcing at longitudes counted from that of the centre of the low.

        With the derivatives of the low written out, nothing is divided by the cosine of the
        latitude.
        """
        a, speed = EARTH.radius, self.u0 / EARTH.radius
        low = _Low.at(lon, lat)
        sin, cos = np.sin(2.0 * lat), np.cos(2.0 * lat)
        mean = _jet(self.u0, lat)
        mean_tan = 2.0 * self.u0 * sin**13 * np.sin(lat) ** 2  # ū tan θ: zero at the poles
        u, spin = mean + low.u, 2.0 * EARTH.rotation * np.cos(lat)
        shear = 28.0 * self.u0 * sin**13 * cos / a + low.u_lat
        east = -speed * low.u_lon - u * low.v_lat + low.v * shear
        north = -speed * low.v_lon + u * low.bend + low.v * low.v_lat
        north += (mean_tan * low.u + spin * low.psi) / a
        pull = -self.u0 * EARTH.coriolis(lon, lat) * np.cos(lat)
        depth = low.v * (pull + (spin * low.psi - mean * mean_tan) / a)
        return east, north, depth / EARTH.gravity


@dataclass(frozen=True)
class _Low:
    """The low, ψ(C), at longitudes counted from that of its centre."""

    psi: Array
    """Streamfunction [m2 s-1]."""
    u: Array
    """-∂ψ/∂θ / a [m s-1]."""
    v: Array
    """∂ψ/∂λ / (a cos θ) [m s-1]."""
    u_lon: Array
    v_lon: Array
    """∂u/∂λ and ∂v/∂λ [m s-1 rad-1]."""
    u_lat: Array
    v_lat: Array
    """∂u/∂θ / a and ∂v/∂θ / a [s-1]."""
    bend: Array
    """(∂v/∂λ / cos θ + u tan θ) / a, with what is infinite at the poles cancelled [s-1]."""

    @classmethod
    def at(cls, lon: Array, lat: Array) -> _Low:
        """The low at the points, by the chain rule from ψ' = dψ/dC and ψ''."""
        a, sin, cos = EARTH.radius, np.sin(lat), np.cos(lat)
        around, side = np.cos(CENTRE) * np.cos(lon), np.cos(CENTRE) * np.sin(lon)
        c = _cosine(lon, lat)
        c_lat = np.sin(CENTRE) * cos - around * sin
        near = np.maximum(1.0 + c, 1e-9)  # zero at the antipode of the centre
        psi = STRENGTH * np.exp(-SHARPNESS * (1.0 - c) / near)
        once = 2.0 * SHARPNESS * psi / near**2
        twice = 4.0 * SHARPNESS * psi * (SHARPNESS - near) / near**4
        return cls(
            psi=psi,
            u=-once * c_lat / a,
            v=-once * side / a,
            u_lon=side * (twice * cos * c_lat - once * sin) / a,
            v_lon=(twice * cos * side**2 - once * around) / a,
            u_lat=(once * c - twice * c_lat**2) / a**2,
            v_lat=-twice * side * c_lat / a**2,
            bend=(twice * side**2 - once * c) / a**2,
        )


def _cosine(lon: Array, lat: Array) -> Array:
    """C, at longitudes counted from that of the centre of the low [rad]."""
    cosine: Array = np.sin(CENTRE) * np.sin(lat) + np.cos(CENTRE) * np.cos(lat) * np.cos(lon)
    return cosine


def _jet(u0: float, lat: Array) -> Array:
    """ū [m s-1]."""
    wind: Array = u0 * np.sin(2.0 * lat) ** 14
    return wind
