"""The barotropically unstable jet of Galewsky, Scott & Polvani (2004), Tellus A 56, 429-440.

doi:10.3402/tellusa.v56i5.14436.  A variant relaxes to the jet: Held & Suarez's idea in one layer.
"""

from dataclasses import replace

import numpy as np

from swe_sphere.equations.effects import DYNAMICS, Hyperviscosity, Relaxation, Rotation
from swe_sphere.equations.scene import Array, Scene, UnsteadyState
from swe_sphere.errors import ConfigError
from swe_sphere.planet import DAY, EARTH
from swe_sphere.testcases.flows import ZonalJet, recommended, wrapped
from swe_sphere.testcases.random_flow import BalancedFlow, random_streamfunction

PAPER = "Galewsky, Scott & Polvani (2004), Tellus A 56, 429-440, doi:10.3402/tellusa.v56i5.14436"
SOUTH_POLE_DEPTH = 10158.18617045462
"""Depth at the south pole [m] for which the mean depth without the perturbation is 10 km."""
JET = ZonalJet(speed=80.0, south=np.pi / 7.0, north=np.pi / 2.0 - np.pi / 7.0)
"""The jet at 45°N (eq. 2)."""


@recommended(ne=12, np=8, dt=150.0, days=6.0)
def galewsky(
    perturbed: bool = True, speed: float = 80.0, seed: int = 0, noise: float = 0.1
) -> Scene:
    """Barotropically unstable jet at 45°N, set off by a bump of 120 m.

    With u(θ) = 80 m/s exp(4/(θ1-θ0)²) exp(1/((θ-θ0)(θ-θ1))) between θ0 = π/7 and θ1 = π/2 - θ0,

        g h = g h00 - ∫ a u (f + u tan θ / a) dθ  (+ g 120 m cos θ exp(-(3λ)²) exp(-(15(π/4-θ))²))

    The bump raises the mean depth from 10 km by 1/3 m. The paper also runs the case with
    `--set viscosity.nu=1e5`; without it vorticity does not converge after day 4.

    Args:
        perturbed: with the bump. Without it the flow is steady (exact), so that all that grows is
            the imprint of the grid.
        speed: of the jet [m s-1], 80 in the paper; the mean depth falls with it from 10158 m.
        seed: of random winds in linear balance, with the same energy at each degree of the
            spherical harmonics from 2 to 20: members of an ensemble; 0: none.
        noise: root mean square of the random winds [m s-1].
    """
    if seed < 0:
        raise ConfigError(f"galewsky: seed must not be negative, but is {seed}")
    flow = _balanced(replace(JET, speed=speed))
    found = random_streamfunction(np.ones_like, 20, noise, EARTH.radius, seed)
    random = BalancedFlow(found, EARTH, 0.0, linear=True)

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        u, v, depth = flow(lon, lat, 0.0)
        if seed:
            du, dv, dh = random.state(lon, lat)
            u, v, depth = u + du, v + dv, depth + dh
        return u, v, depth + bump(lon, lat) if perturbed else depth

    return Scene(
        name="galewsky",
        title="barotropically unstable jet",
        reference=PAPER,
        effects=(*DYNAMICS, Rotation()),
        initial=initial,
        exact=None if perturbed or seed else flow,
        report="vorticity at days 4, 5 and 6; unperturbed: growth of the northward wind",
    )


def _balanced(jet: ZonalJet) -> UnsteadyState:
    """Return a jet over the depth in balance with it."""

    def state(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        depth = SOUTH_POLE_DEPTH - jet.drop(lat) / EARTH.gravity
        return jet(lat) + 0.0 * lon, 0.0 * (lon + lat), depth + 0.0 * lon

    return state


def bump(lon: Array, lat: Array) -> Array:
    """The perturbation of depth [m] (eq. 4)."""
    across = np.exp(-((3.0 * wrapped(lon)) ** 2))
    h: Array = 120.0 * np.cos(lat) * across * np.exp(-((15.0 * (np.pi / 4.0 - lat)) ** 2))
    return h


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

    flow = _balanced(JET)

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        u, v, depth = flow(lon, lat, 0.0)
        return u, v, depth + bump(lon, lat) if perturbed else depth

    return Scene(
        name="relaxed-jet",
        title="jet with relaxation",
        reference="proposed here, after Held & Suarez (1994), Bull. Amer. Meteor. Soc. 75, "
        "1825-1830, doi:10.1175/1520-0477(1994)075<1825:APFTIO>2.0.CO;2; "
        "jet of Galewsky, Scott & Polvani (2004), doi:10.3402/tellusa.v56i5.14436",
        effects=(*DYNAMICS, Rotation(), Relaxation(time * DAY), Hyperviscosity()),
        initial=initial,
        equilibrium=lambda lon, lat: flow(lon, lat, 0.0)[2],
        report="mean depth against its exponential; zonal mean of the wind, days 20 to 60",
    )
