"""Jacobians as operators, and the difference of two right-hand sides against the exact one."""

from dataclasses import replace

import numpy as np
import pytest
from support import make_scene, random_state, relative, tangent

from swe_sphere.equations.effects import Tracers
from swe_sphere.equations.jacobian import DifferenceJacobian
from swe_sphere.equations.model import Model
from swe_sphere.mesh import Mesh
from swe_sphere.steppers import get_stepper
from swe_sphere.testcases import get_scene

from .support import thorough

MESH = Mesh.build(3, 4)


def model_with(mesh, scene, kind: str, **options) -> Model:
    """A model with the exact Jacobian, or with differences of right-hand sides in its place."""
    model = Model(mesh, scene, **options)
    if kind == "difference":
        model.jacobian = lambda: DifferenceJacobian(model, model.names, model.tendency)
    return model


def products(precision: str) -> tuple[np.ndarray, np.ndarray]:
    """J d by both ways for a random direction at williamson5's start."""
    found = []
    for jacobian in ("exact", "difference"):
        model = model_with(MESH, get_scene("williamson5"), precision=precision, kind=jacobian)
        state, out = model.initial_state(), model.zeros()
        direction = np.random.default_rng(1).standard_normal(model.size)
        direction[-MESH.size :] *= 100.0
        model.jacobian().update(state, 0.0)(model.device_mesh.upload(direction), out)
        found.append(out.numpy().astype(np.float64))
    return found[0], found[1]


@pytest.mark.parametrize(
    ("precision", "bound"),
    [("float64", 1e-6), pytest.param("float32", 2e-2, marks=pytest.mark.thorough)],
)
def test_has_half_the_digits_of_the_exact_product(precision: str, bound: float) -> None:
    exact, difference = products(precision)
    for a, b in zip(exact.reshape(3, -1), difference.reshape(3, -1), strict=True):
        error = np.linalg.norm(b - a) / np.linalg.norm(a)
        assert np.finfo(precision).eps < error < bound


@pytest.mark.parametrize("moved", [(1.0, 1.0, 100.0), (0.0, 0.0, 100.0), (1.0, 1.0, 0.0)])
@pytest.mark.parametrize("wind", [0.0, 1e-9])
@pytest.mark.parametrize(
    ("precision", "bound"),
    [("float64", 3e-8), pytest.param("float32", 1e-3, marks=pytest.mark.thorough)],
)
def test_of_a_fluid_at_rest(precision: str, bound: float, wind: float, moved) -> None:
    """Or nearly so: the scale of a wind that is none is the speed of gravity waves."""
    scene, n, found = make_scene("advection", "pressure", "rotation"), MESH.size, []
    direction = np.random.default_rng(1).standard_normal(3 * n) * np.repeat(moved, n)
    for jacobian in ("exact", "difference"):
        model = model_with(MESH, scene, precision=precision, kind=jacobian)
        state, out = (
            model.state_from(*np.multiply.outer((wind, wind, 1e3), np.ones(n))),
            model.zeros(),
        )
        model.jacobian().update(state, 0.0)(model.device_mesh.upload(direction), out)
        found.append(out.numpy().astype(np.float64))
    scale = np.linalg.norm(found[0].reshape(3, -1) * [[1.0], [1.0], [0.1]])
    error = np.linalg.norm((found[1] - found[0]).reshape(3, -1) * [[1.0], [1.0], [0.1]])
    assert error < bound * scale


def test_of_a_tracer_of_which_there_is_none() -> None:
    """A direction with nothing but rounding of it leaves all digits of the rest."""
    tracers = {"none": lambda lon, lat: 0.0 * lon}
    scene = make_scene("advection", "pressure")
    scene = replace(scene, effects=(*scene.effects, Tracers()), tracers=tracers)
    n, found = MESH.size, []
    for noise in (0.0, 1e-18, 1.0):
        model = model_with(MESH, scene, kind="difference")
        direction, out = np.random.default_rng(1).standard_normal(4 * n), model.zeros()
        direction[3 * n :] *= noise
        model.jacobian().update(model.initial_state(), 0.0)(
            model.device_mesh.upload(direction), out
        )
        found.append(out.numpy())
    for other in found[1:]:
        assert relative(other[: 3 * n], found[0][: 3 * n], 3) < 1e-6
    exact = tangent(Model(MESH, scene), model.initial_state().numpy(), direction)
    assert relative(found[-1], exact, 4) < 1e-4


def test_of_no_direction_is_zero() -> None:
    model = model_with(MESH, get_scene("williamson2"), kind="difference")
    out = model.initial_state()
    model.jacobian().update(model.initial_state(), 0.0)(model.zeros(), out)
    assert not out.numpy().any()


def test_waves_that_leave_a_fluid_at_rest_are_those_of_the_exact_product() -> None:
    ends = []
    for jacobian in ("exact", "difference"):
        model = model_with(MESH, get_scene("gravity-bumps"), kind=jacobian)
        stepper = get_stepper("sdirk3")(model, 3600.0)
        stepper.start(model.initial_state())
        for _ in range(3):
            stepper.step()
        ends.append(stepper.state.numpy())
    assert relative(ends[1], ends[0], 3) < 1e-3


def test_newton_takes_the_same_steps_with_it() -> None:
    ends = []
    for jacobian in ("exact", "difference"):
        model = model_with(MESH, get_scene("williamson5"), kind=jacobian)
        stepper = get_stepper("implicit-midpoint")(model, 3600.0, tolerance=1e-6)
        stepper.start(model.initial_state())
        for _ in range(4):
            stepper.step()
        ends.append((stepper.state.numpy(), stepper.counters["newton_iterations"]))
    (exact, newton), (difference, newton_too) = ends
    np.testing.assert_allclose(difference, exact, rtol=0.0, atol=1e-4 * np.abs(exact).max())
    assert abs(newton - newton_too) <= 1


@pytest.mark.parametrize("kind", ["exact", "difference"])
@pytest.mark.parametrize("shape", ["element", "node"])
@pytest.mark.parametrize(
    "effects",
    [
        ("advection", "pressure"),
        ("wind",),
        thorough(("pressure", "quadratic-drag", "hyperviscosity")),
    ],
    ids="+".join,
)
def test_two_linearisations_are_used_in_turns(effects, shape: str, kind: str) -> None:
    """At states and times of their own: neither knows of the other, nor of later tendencies."""
    scene, times = make_scene(*effects), (0.0, 0.25)
    alone = model_with(MESH, scene, shape=shape, kind=kind)
    states = [random_state(alone, seed) for seed in (1, 2)]
    direction = random_state(alone, seed=3)
    expected = [tangent(alone, *at) for at in zip(states, 2 * [direction], times, strict=True)]
    model = model_with(MESH, scene, shape=shape, kind=kind)
    points, d, out = map(model.device_mesh.upload, states), model.device_mesh.upload(direction), []
    both = [model.jacobian().update(point, t) for point, t in zip(points, times, strict=True)]
    for jacobian in (*both, *both):
        result = model.zeros()
        jacobian(d, result)
        model.tendency(result, 7.0, model.zeros())
        out.append(result.numpy())
    assert all((found == again).all() for found, again in zip(expected * 2, out, strict=True))
    assert relative(expected[0], expected[1]) > 1e-3


def test_an_update_moves_the_same_operator_and_products_are_counted() -> None:
    model = Model(MESH, get_scene("williamson5"))
    first, second = (random_state(model, seed) for seed in (1, 2))
    direction, out = random_state(model, seed=3), model.zeros()
    jacobian = model.jacobian().update(model.device_mesh.upload(first), 0.0)
    assert jacobian.update(model.device_mesh.upload(second), 0.0) is jacobian
    jacobian(model.device_mesh.upload(direction), out)
    assert model.counters["tangent_evaluations"] == 1
    np.testing.assert_array_equal(out.numpy(), tangent(model, second, direction))
