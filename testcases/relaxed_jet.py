"""A jet that breaks and is made again: Held & Suarez's idea in one layer of shallow water."""

import numpy as np

from swe_sphere.equations.effects import DYNAMICS, Hyperviscosity, Relaxation, Rotation
from swe_sphere.equations.scene import Array, Scene
from swe_sphere.errors import ConfigError
from swe_sphere.planet import DAY, EARTH
from swe_sphere.testcases.galewsky import JET, SOUTH_POLE_DEPTH, bump
from swe_sphere.testcases.recommended import recommended


@recommended(ne=16, np=4, dt=300.0, days=60.0)
def relaxed_jet(time: float = 10.0, perturbed: bool = True) -> Scene:
    """Barotropically unstable jet whose depth is pulled back to that of the jet.

    The jet of Galewsky et al. (2004) and its bump, with

        ∂h/∂t = … - (h - h_eq) / τ,  h_eq in balance with the jet.

    After a week the jet has rolled up into vortices, while the relaxation builds its slope of depth
    again: at day 20 four waves run along it. The area mean of the depth knows nothing of all that:
    it falls from 1/3 m above that of h_eq as exp(-t / τ), which is exact.
    Grid-scale enstrophy is taken out by the hyperviscosity that goes with the mesh.

    Args:
        time: τ [days].
        perturbed: with the bump. Without it the jet is steady (exact, but for hyperviscosity).

    Raises:
        ConfigError: a time that is not positive.
    """
    if not 0.0 < time < np.inf:
        raise ConfigError(f"relaxed-jet: time must be positive and finite, not {time}")

    def equilibrium(lon: Array, lat: Array) -> Array:
        return SOUTH_POLE_DEPTH - JET.balance.drop(lat) / EARTH.gravity + 0.0 * lon

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        depth = equilibrium(lon, lat)
        return JET(lat) + 0.0 * lon, 0.0 * lat, depth + bump(lon, lat) if perturbed else depth

    return Scene(
        name="relaxed-jet",
        title="jet with relaxation",
        reference="proposed here, after Held & Suarez (1994), Bull. Amer. Meteor. Soc. 75, "
        "1825-1830, doi:10.1175/1520-0477(1994)075<1825:APFTIO>2.0.CO;2; "
        "jet of Galewsky, Scott & Polvani (2004), doi:10.3402/tellusa.v56i5.14436",
        effects=(*DYNAMICS, Rotation(), Relaxation(time * DAY), Hyperviscosity()),
        initial=initial,
        equilibrium=equilibrium,
        report="mean depth against its exponential; zonal mean of the wind, days 20 to 60",
    )
