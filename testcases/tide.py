"""The tide that the Moon or the Sun raises in an ocean that covers the globe."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from swe_sphere.equations.effects import DYNAMICS, Forcing, Linearised, Rotation
from swe_sphere.equations.scene import Array, Scene
from swe_sphere.errors import ConfigError
from swe_sphere.planet import EARTH
from swe_sphere.testcases.flows import coriolis
from swe_sphere.testcases.tidal_equations import TidalEquations

Constituent = Literal["m2", "s2", "k1", "o1"]


@dataclass(frozen=True)
class EquilibriumTide:
    """η_eq = A cos² θ cos(2 λ + ω t), semidiurnal, or A sin 2θ cos(λ + ω t), diurnal."""

    cycles: int
    """Highs around a circle of latitude: 1 or 2."""
    amplitude: float
    """A [m]."""
    frequency: float
    """ω [s-1]."""

    def gradient(self, lon: Array, lat: Array, t: float) -> tuple[Array, Array]:
        """∂/∂λ / cos θ and ∂/∂θ [m rad-1]."""
        phase = self.cycles * lon + self.frequency * t
        sine, cos = np.sin(lat), np.cos(lat)
        if self.cycles == 2:
            along, across = 2.0 * cos, -2.0 * sine * cos
        else:
            along, across = 2.0 * sine, 2.0 * np.cos(2.0 * lat)
        return -self.amplitude * along * np.sin(phase), self.amplitude * across * np.cos(phase)

    @property
    def coefficients(self) -> Array:
        """Of the normalised harmonics of degrees m, m + 1, …: all in degree two."""
        return np.array([0.0, self.amplitude / np.sqrt(15.0 / 8.0)])[self.cycles - 1 :]


TIDES = {
    "m2": EquilibriumTide(2, 0.242334, 1.405189e-4),
    "s2": EquilibriumTide(2, 0.112743, 1.454441e-4),
    "k1": EquilibriumTide(1, 0.141565, 7.292117e-5),
    "o1": EquilibriumTide(1, 0.100661, 6.759774e-5),
}
"""Amplitudes and frequencies as in Arbic et al. (2004), for a rigid Earth."""


def tide(constituent: Constituent = "m2", depth: float = 4000.0, linear: bool = True) -> Scene:
    """Tide in an ocean of even depth over the whole globe (exact).

    The wind is driven by g ∇η_eq, the equilibrium tide of one constituent:

        η_eq = A cos² θ cos(2 λ + ω t)  (m2, s2),  η_eq = A sin 2θ cos(λ + ω t)  (k1, o1)

    The start is the response that keeps pace with it, a series of spherical harmonics that is
    solved to round-off. The m2 tide in 4 km is inverted: low water under the Moon, 0.46 m at the
    equator where the equilibrium tide has 0.24 m above. The k1 tide, whose period is a turn of the
    Earth, has currents and no elevation, as Laplace found; here it has 3e-5 of the equilibrium's,
    as ω is given to 7 digits and Ω of these scenes to 4.

    Args:
        constituent: m2, s2 (two highs a day), k1 or o1 (one).
        depth: of the water at rest [m], 1000 to 1e6, so that the series is right to round-off.
        linear: equations linearised about rest; else the full ones, which differ by about
            elevation over depth.

    Raises:
        ConfigError: a depth out of range.
    """
    if not 1e3 <= depth <= 1e6:
        raise ConfigError(f"tide: depth must be 1000 m to 1e6 m, not {depth}")
    raised = TIDES[constituent]
    equations = TidalEquations(raised.cycles, depth, EARTH)
    response = equations.forced(-raised.frequency, raised.coefficients)

    def forcing(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        scale = EARTH.gravity / EARTH.radius
        east, north = raised.gradient(lon, lat, t)
        return scale * east, scale * north, 0.0 * lat

    return Scene(
        name="tide",
        title=f"{constituent} tide in an ocean of {depth:g} m",
        reference="Arbic, Garner, Hallberg & Simmons (2004), Deep-Sea Res. II 51, 3069-3101, "
        "doi:10.1016/j.dsr2.2004.09.014; solution after Longuet-Higgins (1968), "
        "doi:10.1098/rsta.1968.0003",
        effects=(*DYNAMICS, Rotation(), Forcing(), *((Linearised(),) if linear else ())),
        initial=lambda lon, lat: response.state(lon, lat, 0.0),
        exact=response.state,
        forcing=forcing,
        base=(lambda lon, lat: (0.0 * lon, 0.0 * lat, depth + 0.0 * lat)) if linear else None,
        coriolis=coriolis,
        report="elevation and currents after ten tides; phase against the Moon",
        ne=4,
        np=8,
        dt=600.0,
        days=5.0,
    )
