"""Limits of steppers that treat linear gravity waves implicitly and the rest explicitly."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.model import Model
from swe_sphere.equations.spectrum import Spectrum
from swe_sphere.solvers.gravity_waves import GravityWaves
from swe_sphere.steppers.flow_limit import strongest_advection
from swe_sphere.steppers.stability import Complex, largest_step

MUCH_FASTER = 1e4
"""How many times faster than the explicit waves the implicit ones may be in the analysis of
stability."""

Growth = Callable[[Complex, Complex, Complex], NDArray[np.float64]]
"""Largest amplification factors for eigenvalues times dt of implicit waves, explicit waves and
dissipation."""


def explicit_spectrum(model: Model, state: wp.array, t: float = 0.0) -> Spectrum:
    """Spectral radii [s-1] of F - L, with L the implicit waves.

    That is the advection at the strongest wind of a trial run: see `strongest_advection`.
    """
    at_start = GravityWaves(model.inviscid).explicit_spectrum(state, t)
    return replace(at_start, wave=max(at_start.wave, strongest_advection(model)))


def implicit_explicit_step(
    growth: Growth, wave: float, dissipation: float, faster: float = 8.0
) -> float:
    """Largest step [s] that amplifies no mode, the implicit waves being far faster.

    wave: spectral radius of the explicit part, see `explicit_spectrum`; with that of the whole
    right-hand side in its place the step is shorter than it needs to be.  faster: how many times
    faster than the explicit waves the implicit ones are at least.
    """
    of_faster = np.geomspace(faster, MUCH_FASTER, 40)
    factors = np.concatenate([-of_faster, [0.0], of_faster])

    def largest(z_wave: Complex, z_dissipation: Complex) -> NDArray[np.float64]:
        z_implicit = factors.reshape(-1, *(1 for _ in z_wave.shape)) * z_wave
        found: NDArray[np.float64] = growth(z_implicit, z_wave, z_dissipation).max(axis=0)
        return found

    return largest_step(largest, wave, dissipation, reach=8.0)
