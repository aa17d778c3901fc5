"""Cross-polar flow of McDonald & Bates (1989)."""

import numpy as np

from swe_sphere.equations.effects import DYNAMICS, Rotation
from swe_sphere.equations.scene import Array, Scene
from swe_sphere.planet import EARTH
from swe_sphere.testcases.recommended import recommended

PAPER = (
    "McDonald & Bates (1989), Mon. Wea. Rev. 117, 130-137, "
    "doi:10.1175/1520-0493(1989)117<0130:SLIOAS>2.0.CO;2"
)
DEPTH = 5.768e4
"""g h in the mean [m2 s-2]."""
SPEED = 20.0
"""Speed of the wind over the poles [m s-1]."""


@recommended(ne=16, np=4, dt=600.0, days=10.0)
def mcdonald_bates() -> Scene:
    """Cross-polar flow in geostrophic balance.

    Winds of 20 m/s blow straight over both poles:

        g h = g h0 + 2 Ω a v0 sin³ θ cos θ sin λ,  g h0 = 5.768e4 m² s⁻²
        u = -v0 sin λ sin θ (4 cos² θ - 1),  v = v0 cos λ sin² θ

    There is no exact solution. The flow stays the same under λ → λ + π, θ → -θ with v → -v
    (reflection at the planet's centre), which the cubed sphere shares.
    """

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        sin, cos = np.sin(lat), np.cos(lat)
        u = -SPEED * np.sin(lon) * sin * (4.0 * cos**2 - 1.0)
        swell = 2.0 * EARTH.rotation * EARTH.radius * SPEED * sin**3 * cos * np.sin(lon)
        return u, SPEED * sin**2 * np.cos(lon), (DEPTH + swell) / EARTH.gravity

    return Scene(
        name="mcdonald-bates",
        title="cross-polar flow",
        reference=PAPER,
        effects=(*DYNAMICS, Rotation()),
        initial=initial,
        report="depth at days 5 and 10; drift of energy and potential enstrophy; loss of the"
        " symmetry about the planet's centre",
    )
