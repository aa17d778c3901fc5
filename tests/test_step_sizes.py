"""Steps of any size: with default tolerances errors in time are those of exact solves."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import warp as wp

from swe_sphere.equations.model import Model
from swe_sphere.io.integrals import field_errors
from swe_sphere.mesh import Mesh
from swe_sphere.planet import HOUR
from swe_sphere.solvers.vector_space import VectorSpace
from swe_sphere.steppers import STEPPERS, Stepper
from swe_sphere.steppers.stage_solver import SHARE, TimeDerivatives
from swe_sphere.testcases import get_scene

from .support import thorough

LONG, SHORT = 900.0, 120.0
FILTERED = "semi-implicit"
SOLVING = [name for name, cls in STEPPERS.items() if hasattr(cls, "error_constant")]
STAGES = {
    "tr-bdf2": 2, "sdirk3": 3, "esdirk4": 5, "ark2": 2, "ars343": 3,
}  # fmt: skip
"""Solves a step, where it is not one."""


def advance(
    name: str, dt: float, scene: str = "lauter", precision: str = "float64", hours: float = 2.0,
    **options: float,
) -> Stepper:  # fmt: skip
    """A stepper after some hours of a scene on a small mesh."""
    model = Model(Mesh.build(3, 4), get_scene(scene), precision=precision)
    stepper = STEPPERS[name](model, dt, **options)
    stepper.start(model.initial_state())
    for _ in range(round(hours * HOUR / dt)):
        stepper.step()
    return stepper


@functools.cache
def converged(scene: str) -> dict[str, np.ndarray]:
    """The fields of a run that is converged in time."""
    stepper = advance("rk4", 30.0, scene)
    return stepper.model.fields(stepper.state)


def error(stepper: Stepper, scene: str = "lauter") -> float:
    """Relative error in time of the wind."""
    fields = stepper.model.fields(stepper.state)
    return field_errors(stepper.model.mesh.area, fields, converged(scene))["v"]["l2"]


@pytest.mark.parametrize("name", SOLVING)
@pytest.mark.thorough
def test_short_steps_converge_with_default_tolerances(name: str) -> None:
    """At no less than 0.85 of the order, to 1.15 times the errors of exact solves."""
    found = {dt: advance(name, dt) for dt in (LONG, SHORT)}
    at = {dt: error(stepper) for dt, stepper in found.items()}
    for dt in (LONG, SHORT):
        assert at[dt] <= 1.15 * error(advance(name, dt, tolerance=1e-10))
    order = np.log(at[LONG] / at[SHORT]) / np.log(LONG / SHORT)
    assert order >= 0.85 * (1 if name == FILTERED else STEPPERS[name].order)
    solves = STAGES.get(name, 1) * found[SHORT].steps
    assert found[SHORT].counters["krylov_iterations"] >= solves


@pytest.mark.parametrize("name", [thorough("esdirk4"), "gauss-legendre", "ark2"])
def test_float32_takes_corrections_too(name: str) -> None:
    """Waves of the wind that are smaller than the round-off of the depth: as good as rk4."""
    implicit, explicit = (
        advance(stepper, 240.0, "matsuno", "float32", hours=6.0) for stepper in (name, "rk4")
    )
    ours, theirs = (s.model.fields(s.state) for s in (implicit, explicit))
    assert field_errors(implicit.model.mesh.area, ours, theirs)["v"]["l2"] < 0.05


@pytest.mark.parametrize("name", ["bdf2", "esdirk4"])
def test_unresolved_motion_is_solved_to_the_tolerance_that_was_asked_for(name: str) -> None:
    stepper = advance(name, 7200.0, "williamson5", hours=8.0)
    assert stepper.solver.tolerance == STEPPERS[name].default_tolerance
    asked = advance(name, 7200.0, "williamson5", hours=8.0, tolerance=1e-6)
    assert asked.solver.tolerance == 1e-6


@pytest.mark.parametrize("steps", [[300.0] * 4, [300.0, 250.0, 310.0, 280.0]])
def test_frequencies_of_an_oscillation_are_its_own(steps: list[float]) -> None:
    """And what a solver may leave is a part of the error constant times the angle to the order."""
    omega, space = 1e-4, VectorSpace(np.ones(2))
    times = np.concatenate([[0.0], np.cumsum(steps)])
    states = [
        wp.array([np.cos(omega * t), np.sin(omega * t)], dtype=wp.float64, device="cpu")
        for t in times
    ]
    motion = TimeDerivatives(space)
    for old, new, dt in zip(states, states[1:], steps, strict=False):
        motion.accept(old, new, dt)
    assert motion.rate == pytest.approx(omega, rel=1e-3)
    equal = len(set(steps)) == 1
    assert motion.frequencies == pytest.approx((omega, omega), rel=0.01 if equal else 0.1)
    assert motion.truncation(0.1, 3, 100.0) == pytest.approx(SHARE * 0.1 * 0.01**3, rel=0.3)
    assert motion.truncation(0.1, 3, 1e6) == SHARE * 0.1


def test_a_start_knows_its_frequency() -> None:
    """From the right-hand side at the start and a moment later: x'' = J F, by the tangent."""
    model = Model(Mesh.build(3, 4), get_scene("lauter"))
    stepper = STEPPERS["tr-bdf2"](model, 600.0)
    stepper.start(model.initial_state())
    slope, bend = model.zeros(), model.zeros()
    model.tendency(stepper.state, 0.0, slope)
    model.jacobian().update(stepper.state, 0.0)(slope, bend)
    size = stepper.space.norm
    assert stepper.solver.rate == pytest.approx(size(slope), rel=1e-12)
    assert stepper.solver.frequencies[0] == pytest.approx(size(bend) / size(slope), rel=1e-2)
