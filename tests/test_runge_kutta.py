"""Explicit Runge-Kutta steps against the sums of slopes that their kernels never form."""

from __future__ import annotations

import numpy as np
import pytest

from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.runge_kutta import RungeKutta
from swe_sphere.steppers.stability import tableau

from .support import make_scene, random_state, relative, tendency, thorough
from .test_tracers import rough, with_tracers

FLOW = ("advection", "pressure", "rotation")


def method(*rows: tuple[float, ...]) -> type[RungeKutta]:
    """The method of these rows below the diagonal, of which the last are its weights."""

    class Given(RungeKutta):
        a, b = rows[:-1], rows[-1]

    Given.name = "given"  # later, so that it is not registered
    return Given


METHODS = {
    "kg5": STEPPERS["kg5"],
    "ssprk3": STEPPERS["ssprk3"],
    "one stage": method((1.0,)),
    "slopes left out": method((0.5,), (0.7, 0.0), (0.1, 0.4, 0.0), (0.2, 0.3, 0.1, 0.2)),
}


def summed(cls: type[RungeKutta], model: Model, state: np.ndarray, t: float, dt: float):
    """The step as Butcher's tableau says it."""
    rows, slopes = tableau((*cls.a, cls.b), 1 + len(cls.b))[:, :-1], []
    for row in rows[:-1]:
        at = state + dt * sum((a * k for a, k in zip(row, slopes, strict=False)), 0.0 * state)
        slopes.append(tendency(model, at, t + dt * row.sum()))
    return state + dt * rows[-1] @ np.array(slopes)


@pytest.mark.parametrize(
    ("effects", "tracers", "shape"),
    [
        (FLOW, True, "element"),
        (FLOW, False, "node"),
        thorough((*FLOW, "drag", "forcing"), False, "element"),
        ((*FLOW, "linearised"), False, "element"),
        (("wind",), True, "element"),
        (("relaxation",), False, "element"),
    ],
    ids=str,
)
def test_a_step_is_the_sum_of_its_slopes(small_mesh, effects, tracers, shape) -> None:
    scene = make_scene(*effects)
    model = Model(small_mesh, with_tracers(scene) if tracers else scene, shape=shape)
    state, t, dt = (rough if tracers else random_state)(model).ravel(), 5000.0, 200.0
    for name, cls in METHODS.items():
        stepper = cls(model, dt)
        stepper.start(model.device_mesh.upload(state), t)
        stepper.step()
        change = summed(cls, model, state, t, dt) - state
        error = relative(stepper.state.numpy() - state, change, len(model.names))
        assert error < 1e-11, name


def test_single_precision_keeps_its_digits(small_mesh) -> None:
    """Levels are told apart by their differences, which round-off of their sums would spoil."""
    scene = make_scene(*FLOW)
    single, double = Model(small_mesh, scene, precision="float32"), Model(small_mesh, scene)
    state = random_state(double).astype(np.float32).astype(np.float64)
    for name, cls in METHODS.items():
        stepper = cls(single, 200.0)
        stepper.start(single.device_mesh.upload(state))
        stepper.step()
        expected = summed(cls, double, state, 0.0, 200.0)
        assert relative(stepper.state.numpy(), expected, 3) < 2e-6, name


def test_a_stage_for_nothing_is_refused(small_mesh) -> None:
    with pytest.raises(ConfigError, match="leave out the last stage"):
        method((0.5,), (1.0, 0.0))(Model(small_mesh, make_scene(*FLOW)), 100.0)
