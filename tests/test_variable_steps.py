"""Implicit schemes with steps of any lengths, on motions for which they are exact."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support import IMPLICIT, make_scene

from swe_sphere.equations.model import Model
from swe_sphere.mesh import Mesh
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.implicit import VariableStepper

SECOND_ORDER = ("crank-nicolson", "bdf2", "tr-bdf2", "sdirk3", "esdirk4", "gauss-legendre")
STEPS = (100.0, 250.0, 70.0, 70.0, 310.0, 40.0)
"""Lengths [s]: ratios between 0.13 and 4.4."""
SLOPE, CURVE = (1e-3, -2e-3, 5e-3), (2e-5, 1e-5, -4e-5)
"""Of wind and depth in time [m s-2, m s-2, m s-1], and how they change [... s-1]."""


def forced(curved: bool) -> Model:
    """A fluid that nothing moves but a forcing, the same everywhere."""

    def forcing(lon, lat, t):
        return tuple(
            a + (c * t if curved else 0.0) + 0.0 * lat for a, c in zip(SLOPE, CURVE, strict=True)
        )

    return Model(Mesh.build(2, 4), replace(make_scene("forcing"), forcing=forcing))


def exact(model: Model, t: float, curved: bool) -> np.ndarray:
    start = np.array([10.0, -5.0, 1000.0])
    now = start + np.array(SLOPE) * t + (0.5 * np.array(CURVE) * t**2 if curved else 0.0)
    return np.repeat(now, model.mesh.size)


def take_steps(name: str, model: Model, curved: bool) -> VariableStepper:
    """A stepper after steps of all these lengths from the exact start."""
    stepper = STEPPERS[name](model, STEPS[0], tolerance=1e-12, preconditioner="none")
    stepper.start(model.device_mesh.upload(exact(model, 0.0, curved)))
    return stepper


@pytest.mark.parametrize("name", SECOND_ORDER)
def test_schemes_of_second_order_follow_a_parabola(name: str) -> None:
    model, t = forced(curved=True), 0.0
    stepper = take_steps(name, model, curved=True)
    for dt in STEPS:
        assert stepper.attempt(t, dt) is None
        stepper.accept(dt)
        t += dt
        assert stepper.state.numpy() == pytest.approx(exact(model, t, True), rel=1e-11)


@pytest.mark.parametrize("name", IMPLICIT)
def test_guesses_are_solutions_where_the_state_moves_straight_on(name: str, monkeypatch) -> None:
    model, t, wrong = forced(curved=False), 0.0, []
    stepper = take_steps(name, model, curved=False)
    solve = stepper.solver.newton.solve

    def watched(problem, x, rtol, scale, floor):
        result = solve(problem, x, rtol, scale, floor)
        wrong.append(result.history[0] / scale)
        return result

    monkeypatch.setattr(stepper.solver.newton, "solve", watched)
    for dt in STEPS:
        assert stepper.attempt(t, dt) is None
        stepper.accept(dt)
        t += dt
    assert len(wrong) >= len(STEPS)
    assert max(wrong) < 1e-9
