"""Limits of explicit steppers that depend on the ratio of present or future winds to waves."""

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.equations.model import Model
from swe_sphere.equations.spectrum import SpectralRadii
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY
from swe_sphere.solvers.gravity_waves import advection_rate
from swe_sphere.steppers.runge_kutta import RK4
from swe_sphere.steppers.stability import NO_GROWTH, Complex, largest_moduli, largest_step
from swe_sphere.steppers.stepper import Stepper

INTERVALS = 18
"""Approximate largest number of node intervals along an edge of the trial run's cube."""
DAYS = 6.0
"""Largest length of the trial run [days]; winds grow little until `planning.LONG_RUN`."""
SAMPLES, MOST_STEPS = 8, 2000
"""Number of states of the trial run that are examined, and its largest number of steps."""


def strongest_advection(model: Model) -> float:
    """Return the largest `advection_rate` [s-1] that the scene is likely to have in its first days.

    A run of rk4 on a coarse mesh supplies it, scaled by the ratio of gravity-wave rates on the
    model's mesh and on the coarse one: the wind of williamson5 doubles in three days over its
    mountain, which the initial state does not show. An unstable run counts until then.
    """
    mesh, scene = model.mesh, model.scene
    ne = min(mesh.ne, math.ceil(INTERVALS / (mesh.np - 1)))
    small = Mesh.build(ne, mesh.np, mesh.radius, mesh.stretch, mesh.centre, mesh.spin)
    if model.tracers is not None:
        scene = scene.without_effect("tracers")
    coarse = Model(small, scene, model.device, model.precision, model.shape)
    state = coarse.initial_state()
    radii = RK4.spectral_radii(coarse, state)
    dt = RK4.safety * RK4.stable_dt(radii)
    steps = min(min(coarse.scene.days, DAYS) * DAY / dt, MOST_STEPS)
    stepper = RK4(coarse, dt)
    stepper.start(state)
    largest = advection_rate(coarse, state)
    for sample in range(1, SAMPLES + 1):
        while stepper.steps < math.ceil(sample * steps / SAMPLES):
            stepper.step()
        if not np.isfinite(stepper.state.numpy()).all():
            break
        rate = advection_rate(coarse, stepper.state, stepper.time)
        if rate > radii.wave:  # faster than the waves: the run becomes unstable
            break
        largest = max(largest, rate)
    return largest * RK4.spectral_radii(model, model.initial_state()).wave / radii.wave


WIND_PARTS = np.linspace(0.0, 1.0, 5)
"""Fractions of the strongest wind, along the waves, that the analysis of stability samples; a wind
against the waves has the same growth."""
WEAK = 1e-4
"""Accepted growth per step in any wind, where steps of any length may have a little growth."""
NOTHING_BUT_WIND = 1.0
"""`wind_share` of a flow without gravity waves."""


class FlowLimitStepper(Stepper):
    """A stepper whose steps are limited by waves and wind together."""

    reach = 4.0
    tries: ClassVar[int] = 1
    """Number of fractions of the reach to test; the first unstable one bounds the limit."""

    @classmethod
    def spectral_radii(cls, model: Model, state: wp.array, t: float = 0.0) -> SpectralRadii:
        """Return the spectral radii [s-1], with the wind's part of `wave` and the Coriolis rate."""
        found, share = super().spectral_radii(model, state, t), wind_share(model, state)
        inertial = 0.0 if share == NOTHING_BUT_WIND else float(np.abs(model.coriolis).max())
        return replace(found, wind=found.wave * share, inertial=inertial)

    @classmethod
    def stable_dt(cls, radii: SpectralRadii) -> float:
        """Return the largest stable step [s] in winds up to the radius `wind`.

        Waves, vorticity that the wind carries, and inertial oscillations do not grow, or grow in a
        wind by at most `WEAK` a step.
        """
        wave, rates = radii.wave, (radii.wind, radii.inertial)
        share, turn = (rate / wave if wave > 0.0 else 0.0 for rate in rates)
        cases = [(1.0 - share, part * share) for part in (WIND_PARTS if share > 0.0 else (0.0,))]
        cases += [(0.0, share), (0.0, turn)]

        def factor(z_wave: Complex, z_dissipation: Complex) -> Array:
            z, loss = z_wave[..., None], z_dissipation[..., None]
            steps = (cls.propagator(share, waves * z, winds * z, loss) for waves, winds in cases)
            return np.asarray(np.max([largest_moduli(s) for s in steps], axis=0))

        growth = WEAK if share else NO_GROWTH
        return largest_step(factor, wave, radii.dissipation, cls.reach, growth, cls.tries)

    @classmethod
    def propagator(cls, share: float, wave: Complex, wind: Complex, loss: Complex) -> Complex:
        """Return matrices (..., n, n) of a step, for the levels of h' sqrt(g/H), then those of u.

        The wave has dt dh/dt = (loss - wind) h - wave u, and likewise for u. wave, wind and loss
        (..., 1) are rates times dt; `share` is the `wind_share` of the flow.
        """
        raise NotImplementedError


def wind_share(model: Model, state: wp.array) -> float:
    """Return the largest |V| k over the largest (|V| + sqrt(g h)) k; 1 without gravity waves.

    k is the wavenumber of the shortest wave length, up to a factor, in the direction in which the
    element is shortest: one over the smaller singular value of dx/dxi.
    """
    if model.scene.effect("pressure-gradient") is None:
        return NOTHING_BUT_WIND
    mesh, point = model.mesh, model.point_of_tangent(state)[: model.fluid_size]
    u, v, h = model.device_mesh.collect(point).astype(np.float64).reshape(3, -1)
    squares = np.sum(mesh.basis**2, axis=(-2, -1))
    apart = np.sqrt(np.maximum(squares**2 - 4.0 * mesh.jacobian**2, 0.0))
    k = np.sqrt(0.5 * (squares + apart)) / mesh.jacobian
    speed, waves = np.hypot(u, v), np.sqrt(model.scene.planet.gravity * np.maximum(h, 0.0))
    winds, both = ((each[mesh.nodes] * k).max() for each in (speed, speed + waves))
    return float(winds / both) if both > 0.0 else 0.0
