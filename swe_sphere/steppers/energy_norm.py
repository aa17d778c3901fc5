"""The norm in which steppers measure changes and residuals."""

import numpy as np
from numpy.typing import NDArray

from swe_sphere.equations.model import Model
from swe_sphere.equations.tracer_equations import MassFlux, mixing_ratios

TRACER_SHARE = 0.1
"""About the Froude number of the flows here: with it the change of a tracer that the wind carries
along weighs as much as the change of the wind, and does not drown it."""
NOTHING = 1e-60
"""Weights have to be positive."""


def energy_weights(model: Model) -> NDArray[np.float64]:
    """Weights (n,) of the energy inner product: area, times g/H for depth, over the whole area.

    With them a norm is in [m s-1], and tolerances mean the same in any units and on any planet.
    The mass hq of a tracer counts as depth does, over the largest q of the start, and under a wind
    that is stepped by `TRACER_SHARE` of that; the mass that has crossed a point not at all.
    """
    share: NDArray[np.float64] = model.mesh.area / model.mesh.area.sum()
    ratios = mixing_ratios(model.scene, model.mesh).values()
    largest = [float(np.abs(q).max()) or 1.0 for q in ratios]
    if model.scene.wind is not None:
        return np.concatenate([share, *(share / q**2 for q in largest)])
    _, _, depth = model.scene.initial(model.mesh.lon, model.mesh.lat)
    heights = share * model.scene.planet.gravity / float(np.average(depth, weights=share))
    if isinstance(model.carried, MassFlux):
        return np.concatenate([share, share, heights, NOTHING * share, NOTHING * share])
    tracers = (heights * (TRACER_SHARE / q) ** 2 for q in largest)
    return np.concatenate([share, share, heights, *tracers])
