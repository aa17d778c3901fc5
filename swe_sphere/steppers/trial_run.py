"""The wind that a scene will have: a trial run on a coarse mesh, from which a limit is told."""

import math

import numpy as np

from swe_sphere.equations.model import Model
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY
from swe_sphere.solvers.gravity_waves import advection_rate
from swe_sphere.steppers.runge_kutta import RK4

INTERVALS = 18
"""Intervals between nodes along an edge of the cube of its mesh, at most about."""
DAYS = 6.0
"""After which the winds of the scenes that were looked at grow no more, or little."""
LOOKS = 8
MOST_STEPS = 2000


def strongest_advection(model: Model) -> float:
    """Largest `advection_rate` [s-1] that the scene is likely to have in its first days.

    That of rk4 on a coarse mesh, larger by as much as gravity waves are faster on the mesh of the
    model: the wind of williamson5 doubles in three days over its mountain, which no start tells.
    Where that run blows up, it counts as far as it went.
    """
    coarse = _coarse(model)
    state = coarse.initial_state()
    spectrum = RK4.spectrum(coarse, state)
    dt = RK4.safety * RK4.stable_dt(spectrum.wave, spectrum.dissipation)
    steps = min(min(coarse.scene.days, DAYS) * DAY / dt, MOST_STEPS)
    stepper = RK4(coarse, dt)
    stepper.start(state)
    largest = advection_rate(coarse, state)
    for look in range(1, LOOKS + 1):
        while stepper.steps < math.ceil(look * steps / LOOKS):
            stepper.step()
        if not np.isfinite(stepper.state.numpy()).all():
            break
        rate = advection_rate(coarse, stepper.state, stepper.time)
        if rate > spectrum.wave:  # faster than the waves: it blows up
            break
        largest = max(largest, rate)
    return largest * RK4.spectrum(model, model.initial_state()).wave / spectrum.wave


def _coarse(model: Model) -> Model:
    """The scene without its tracers on a mesh of the same shape with fewer elements."""
    mesh = model.mesh
    small = Mesh.build(
        min(mesh.ne, math.ceil(INTERVALS / (mesh.np - 1))), mesh.np, radius=mesh.radius,
        stretch=mesh.stretch, centre=mesh.centre, spin=mesh.spin,
    )  # fmt: skip
    scene = model.scene
    if model.tracers is not None:
        scene = scene.without_effect("tracers")
    return Model(small, scene, model.device, model.precision, model.shape)
