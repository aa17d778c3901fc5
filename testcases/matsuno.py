"""Equatorial waves in a thin layer: the test of Shamir, Yacoby, Ziskin Ziv & Paldor (2019)."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from swe_sphere.equations.effects import DYNAMICS, Linearised, Rotation
from swe_sphere.equations.scene import Array, Scene
from swe_sphere.errors import ConfigError
from swe_sphere.planet import DAY, Planet
from swe_sphere.testcases.flows import at_rest
from swe_sphere.testcases.recommended import recommended

Wave = Literal["rossby", "eig", "wig"]
NAMES = {"rossby": "Rossby", "eig": "eastward inertia-gravity", "wig": "westward inertia-gravity"}
PLANET = Planet(6371220.0, 9.80616, 7.29212e-5)
DEPTH = 30.0
"""Depth at rest [m]: so thin that the waves are trapped near the equator."""


@recommended(ne=8, np=8, dt=1500.0)
def matsuno(
    wave: Wave = "rossby",
    k: int = 5,
    n: int = 1,
    amplitude: float = 1e-5,
    linear: bool = True,
) -> Scene:
    """Equatorial Rossby or inertia-gravity wave (analytic, nearly exact).

    Matsuno's waves on the equatorial β-plane, put on the sphere with y = ε^(1/4) θ and
    ε = (2 Ω a)² / (g H) = 2935: normalised Hermite functions of y times exp(i (k λ - ω t)), where

        ω³ - (g H (k/a)² + 2 Ω (2n + 1) √(g H) / a) ω - 2 Ω g H k / a² = 0

    They solve the equations on the sphere up to terms of relative size ε^(-1/2) = 0.02, so the
    error against them does not vanish with the mesh. What must agree is speed and shape.

    Args:
        wave: "rossby", or eastward or westward inertia-gravity wave, "eig" or "wig".
        k: zonal wavenumber, at least 1.
        n: mode, at least 1: nodes of v between the poles.
        amplitude: factor of the normalised northward wind [m s-1].
        linear: equations linearised about rest; else the full ones, for which the amplitude must
            be tiny. Depth and wave together need float64 then.

    Raises:
        ConfigError: a mode that there is not.
    """
    if k < 1 or n < 1:
        raise ConfigError(f"matsuno: k and n must be at least 1, not {k} and {n}")
    mode = Mode(wave, k, n, amplitude)

    return Scene(
        name="matsuno",
        title=f"equatorial wave ({NAMES[wave]}, k = {k}, n = {n})",
        reference="Shamir, Yacoby, Ziskin Ziv & Paldor (2019), Geosci. Model Dev. 12, 2181-2193, "
        "doi:10.5194/gmd-12-2181-2019",
        effects=(*DYNAMICS, Rotation(), *((Linearised(),) if linear else ())),
        initial=lambda lon, lat: mode.state(lon, lat, 0.0),
        exact=mode.state,
        base=at_rest(DEPTH) if linear else None,
        planet=PLANET,
        report="speed of the pattern against ω / k; shape after a period",
        days=round(2.0 * np.pi / abs(mode.frequency) / DAY, 2),
    )


@dataclass(frozen=True)
class Mode:
    """One of Matsuno's waves (eqs. 2-8 of the paper)."""

    wave: Wave
    k: int
    n: int
    amplitude: float

    @cached_property
    def frequency(self) -> float:
        """ω [s-1]: the largest root goes east, the smallest west, the one between is Rossby's."""
        a, speed, spin = PLANET.radius, np.sqrt(PLANET.gravity * DEPTH), 2.0 * PLANET.rotation
        p = (speed * self.k / a) ** 2 + spin * (2 * self.n + 1) * speed / a
        q = spin * speed**2 * self.k / a**2
        angle = np.arccos(1.5 * q / p * np.sqrt(3.0 / p)) / 3.0  # three real roots (Viète)
        shift = {"eig": 0, "rossby": 1, "wig": 2}[self.wave]
        return float(2.0 * np.sqrt(p / 3.0) * np.cos(angle - 2.0 * np.pi * shift / 3.0))

    def state(self, lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        """Eastward wind, northward wind [m s-1] and depth [m]."""
        phase = self.k * lon - self.frequency * t
        u, v, geopotential = self._profiles(lat)
        # u and g h are a quarter period behind v
        depth = DEPTH + geopotential / PLANET.gravity * np.sin(phase)
        return u * np.sin(phase), v * np.cos(phase), depth

    def _profiles(self, lat: Array) -> tuple[Array, Array, Array]:
        """Amplitudes of u, v [m s-1] and g h [m2 s-2] at the latitudes."""
        a, speed, n = PLANET.radius, np.sqrt(PLANET.gravity * DEPTH), self.n
        stretch = (2.0 * PLANET.rotation * a / speed) ** 0.5  # ε^(1/4)
        y = stretch * lat
        below, here, above = (self.amplitude * f for f in _hermite(n, y))
        slope, wave = self.frequency / speed, self.k / a
        factor = stretch / (a * (slope**2 - wave**2))
        up, down = np.sqrt((n + 1) / 2.0) * above, np.sqrt(n / 2.0) * below
        u = factor * (-(slope + wave) * up - (slope - wave) * down)
        geopotential = speed * factor * (-(slope + wave) * up + (slope - wave) * down)
        return u, here, geopotential


def _hermite(n: int, y: Array) -> tuple[Array, Array, Array]:
    """Normalised Hermite functions of orders n - 1, n and n + 1, n ≥ 1."""
    functions = [0.0 * y, np.pi**-0.25 * np.exp(-0.5 * y**2)]
    for m in range(n + 1):
        up = y * functions[-1] - np.sqrt(m / 2.0) * functions[-2]
        functions.append(np.sqrt(2.0 / (m + 1)) * up)
    return functions[n], functions[n + 1], functions[n + 2]
