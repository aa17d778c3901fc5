"""Colliding modons of Lin, Chen & Yao (2017)."""

import numpy as np

from swe_sphere.equations.effects import DYNAMICS, Hyperviscosity
from swe_sphere.equations.scene import Array, Scene
from swe_sphere.planet import EARTH, Planet
from swe_sphere.testcases.flows import distance
from swe_sphere.testcases.recommended import recommended

PAPER = "Lin, Chen & Yao (2017), J. Adv. Model. Earth Syst. 9, 2483-2492, doi:10.1002/2017MS000965"
SPEED = 50.0
"""Speed of the two bursts of wind [m s-1]."""
WIDTH = 750e3
"""Their width [m]."""


@recommended(ne=30, np=4, dt=240.0, days=100.0)
def modons() -> Scene:
    """Two pairs of vortices that collide, exchange partners and come back.

    On a planet at rest, under a flat surface at 5000 m, two bursts of zonal wind

        u = 50 m/s (exp(-(r1/r0)²) - exp(-(r2/r0)²)),  r0 = 750 km

    with r1, r2 the distances to (π/2, 0) and (3π/2, 0). Gravity waves leave first; the modons that
    form collide near λ = π and λ = 0 and are back near the start after about 100 days. The flow
    stays symmetric about the equator, and about the meridians λ = 0 and π.

    Hyperviscosity that goes with the mesh takes out the enstrophy at the grid scale.
    """

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        bursts = (_burst(lon, lat, 0.5 * np.pi), _burst(lon, lat, 1.5 * np.pi))
        return SPEED * (bursts[0] - bursts[1]), 0.0 * lat, 5000.0 + 0.0 * lat

    return Scene(
        name="modons",
        title="colliding modons",
        reference=PAPER,
        effects=(*DYNAMICS, Hyperviscosity()),
        initial=initial,
        planet=Planet(EARTH.radius, EARTH.gravity, 0.0),
        report="vorticity and largest wind at day 100; drift of energy and potential enstrophy;"
        " symmetry about the equator",
    )


def _burst(lon: Array, lat: Array, centre: float) -> Array:
    """A bump of height 1 on the equator."""
    bump: Array = np.exp(-((EARTH.radius * distance(lon, lat, centre, 0.0) / WIDTH) ** 2))
    return bump
