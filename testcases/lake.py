"""A lake at rest: nothing may move over a mountain under water."""

import numpy as np

from swe_sphere.equations.effects import DYNAMICS, Orography, Rotation
from swe_sphere.equations.scene import Array, Scene
from swe_sphere.mesh.sphere import position
from swe_sphere.testcases.flows import cone as conical_mountain
from swe_sphere.testcases.recommended import recommended

SURFACE = 5960.0
"""Height of the free surface [m]."""
WIDTH = np.pi / 18.0
"""Width of the smooth mountain [rad]: half the radius of the cone."""


@recommended(ne=16, np=4, dt=600.0, days=5.0)
def lake_at_rest(cone: bool = True, rotating: bool = True) -> Scene:
    """Water at rest over a mountain (exact): nothing may move.

    The surface is at 5960 m. Whatever moves shows that the gradients of bottom and depth do not
    cancel as they must.

    Args:
        cone: over the cone of williamson5; else over the smooth 2000 m exp(-|n - n0|²/w²) with
            w = π/18 at the same place.
        rotating: with the Coriolis force.
    """
    bottom = conical_mountain if cone else _smooth_bottom

    def exact(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        return 0.0 * lon, 0.0 * lat, SURFACE - bottom(lon, lat)

    return Scene(
        name="lake-at-rest",
        title="water at rest over a mountain",
        reference="Audusse et al. (2004), SIAM J. Sci. Comput. 25, doi:10.1137/S1064827503431090;"
        " mountain of Williamson et al. (1992), doi:10.1016/S0021-9991(05)80016-6, case 5",
        effects=(*DYNAMICS, *((Rotation(),) if rotating else ()), Orography()),
        initial=lambda lon, lat: exact(lon, lat, 0.0),
        exact=exact,
        bottom=bottom,
        report="largest wind after 5 days: round-off, below 1e-10 m/s in float64",
        error_field="surface",
    )


def _smooth_bottom(lon: Array, lat: Array) -> Array:
    """Height [m] of a smooth mountain at (3π/2, π/6)."""
    offset = position(lon, lat) - position(1.5 * np.pi, np.pi / 6.0)
    height: Array = 2000.0 * np.exp(-np.sum(offset**2, axis=-1) / WIDTH**2)
    return height
