"""Drag and relaxation: exact decay, exact tangents, energy, mass, and each stepper's treatment."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from cartesian import Cartesian
from manufactured import DURATION, MESH, STEPS, answer, manufactured, tight
from support import (
    EXPLICIT,
    IMPLICIT,
    advance,
    make_scene,
    random_state,
    relative,
    tangent,
    tendency,
)

from swe_sphere.equations.effects import Drag, Relaxation
from swe_sphere.equations.model import Model
from swe_sphere.equations.scene import apply_settings
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.leapfrog import Leapfrog
from swe_sphere.testcases import get_scene

SHAPES = ("element", "node")
SETS = (
    ("drag",),
    ("quadratic-drag",),
    ("relaxation",),
    ("drag", "relaxation"),
    ("advection", "pressure", "rotation", "quadratic-drag"),
    ("pressure", "orography", "drag", "viscosity"),
    ("advection", "rotation", "quadratic-drag", "relaxation", "hyperviscosity", "forcing"),
    ("wind", "relaxation"),
    ("wind", "relaxation", "viscosity", "forcing"),
)
LAGGED = ("leapfrog", "semi-implicit", "forward-backward", "fb-rk3")
"""They take dissipation at the past level, which is of first order."""


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("names", SETS, ids="+".join)
@pytest.mark.thorough
def test_right_hand_side_and_tangent(small_mesh, names, shape) -> None:
    """Against the independent formulation, whose derivative is a complex step."""
    scene = make_scene(*names)
    model, check = Model(small_mesh, scene, shape=shape), Cartesian(small_mesh, scene)
    blocks, state = len(model.names), random_state(model)
    direction = 0.1 * random_state(model, seed=2)
    assert relative(tendency(model, state, 0.25), check.tendency(state, 0.25), blocks) < 1e-12
    product = tangent(model, state, direction, 0.25)
    complex_step = check.tendency(state + 1e-30j * direction, 0.25).imag / 1e-30
    assert relative(product, complex_step, blocks) < 1e-12


@pytest.mark.parametrize("names", [s for s in SETS if "quadratic-drag" not in s], ids="+".join)
def test_tangent_is_half_the_difference_whatever_its_size(small_mesh, names) -> None:
    model = Model(small_mesh, make_scene(*names))
    state, direction = random_state(model), 0.1 * random_state(model, seed=2)
    plus, minus = (tendency(model, state + s * direction, 0.25) for s in (1.0, -1.0))
    floor = np.abs(plus).max() * 1e-13
    product = tangent(model, state, direction, 0.25)
    np.testing.assert_allclose(0.5 * (plus - minus), product, rtol=1e-9, atol=floor)


def test_tangent_of_quadratic_drag_in_still_air_is_nothing(small_mesh) -> None:
    model = Model(small_mesh, replace(make_scene("drag"), effects=(Drag(quadratic=1e-5),)))
    state, direction = random_state(model), random_state(model, seed=2)
    state[: 2 * small_mesh.size] = 0.0
    assert not tangent(model, state, direction).any()


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.thorough
def test_parts_add_up(small_mesh, shape, precision) -> None:
    """All of drag and relaxation is in the dissipative part, which has nothing to assemble."""
    model = Model(
        small_mesh, make_scene("pressure", "quadratic-drag", "relaxation", "forcing"),
        shape=shape, precision=precision,
    )  # fmt: skip
    state = model.device_mesh.upload(random_state(model))
    whole, dynamics, damping = (model.zeros() for _ in range(3))
    model.tendency(state, 500.0, whole)
    model.conservative_tendency(state, 500.0, dynamics)
    model.dissipative_tendency(state, damping)
    bound = 1e-12 if precision == "float64" else 1e-5
    assert relative(dynamics.numpy() + damping.numpy(), whole.numpy(), 3) < bound
    alone = Cartesian(small_mesh, make_scene("quadratic-drag", "relaxation"))
    assert relative(damping.numpy(), alone.tendency(state.numpy().astype(float)), 3) < bound


@pytest.mark.parametrize("drag", [Drag(linear=3e-5), Drag(quadratic=4e-6), Drag(1e-5, 2e-6)])
def test_energy_falls_by_the_work_of_drag(small_mesh, drag) -> None:
    """dE/dt = - sum of area h (linear + quadratic |v|) |v|², to round-off, with all of dynamics."""
    names = ("advection", "pressure", "rotation", "orography")
    model = Model(small_mesh, make_scene(*names).with_effect(drag))
    state = random_state(model)
    u, v, h = state.reshape(3, -1)
    du, dv, dh = tendency(model, state).reshape(3, -1)
    area, g, speed = small_mesh.area, model.scene.planet.gravity, np.hypot(u, v)
    potential = (0.5 * speed**2 + g * (h + model.bottom)) * dh
    rate = np.sum(area * (h * (u * du + v * dv) + potential))
    work = np.sum(area * h * (drag.linear + drag.quadratic * speed) * speed**2)
    size = np.sum(area * np.abs(potential))
    assert work > 1e-4 * size
    assert abs(rate + work) < 1e-13 * size


@pytest.mark.parametrize("name", (*EXPLICIT, *IMPLICIT))
@pytest.mark.thorough
def test_wind_decays_as_the_formulas_say(name: str, monkeypatch) -> None:
    """v/v0 = e^(-rt) / (1 + c |v0| (1 - e^(-rt)) / r), and depth goes to equilibrium as e^(-t/T).

    Steps of a hundredth of the time of decay, so that errors of second order are below 1e-4.
    """
    monkeypatch.setattr(Leapfrog, "default_strength", 0.0)
    drag, time = Drag(linear=1e-4, quadratic=2e-6), 2e4
    scene = make_scene("relaxation").with_effect(drag).with_effect(Relaxation(time))
    model = Model(MESH, scene)
    state = random_state(model)
    u, v, h = state.reshape(3, -1)
    dt, duration = 50.0, 5000.0
    last = advance(name, model, model.device_mesh.upload(state), dt, duration, **tight(name))
    left = np.exp(-drag.linear * duration)
    left = left / (1.0 + drag.quadratic * np.hypot(u, v) * (1.0 - left) / drag.linear)
    goal = scene.equilibrium(MESH.lon, MESH.lat)
    exact = np.concatenate([left * u, left * v, goal + (h - goal) * np.exp(-duration / time)])
    first_order = STEPPERS[name].order == 1 or name in LAGGED
    assert relative(last.state.numpy(), exact, 3) < (2e-2 if first_order else 1e-4)


@pytest.mark.parametrize("name", STEPPERS)
@pytest.mark.thorough
def test_every_stepper_keeps_its_order(name: str, monkeypatch) -> None:
    """On a made solution of all of dynamics; but where damping is lagged it is of first order."""
    monkeypatch.setattr(Leapfrog, "default_strength", 0.0)
    names = ("advection", "pressure", "rotation", "quadratic-drag", "relaxation")
    model = Model(MESH, manufactured(*names))
    exact, scale, errors = answer(DURATION), np.repeat([10.0, 10.0, 100.0], MESH.size), []
    lagged = name in LAGGED
    for halving in range(2):
        dt = (112.5 if lagged else STEPS.get(name, 450.0)) / 2**halving
        last = advance(name, model, model.initial_state(), dt, DURATION, **tight(name))
        errors.append(float(np.abs((last.state.numpy() - exact) / scale).max()))
    order = 1 if lagged else STEPPERS[name].order
    assert STEPPERS[name].order_in(model) == order
    for coarse, fine in pairwise(errors):
        assert np.log2(coarse / fine) == pytest.approx(order, abs=0.2)


@pytest.mark.parametrize("name", ["leapfrog", "semi-implicit"])
def test_leapfrog_is_stable_with_damping(name: str, monkeypatch) -> None:
    """Without a filter either: taken at the present level, damping would blow up."""
    monkeypatch.setattr(Leapfrog, "default_strength", 0.0)
    scene = make_scene("pressure").with_effect(Drag(1e-4)).with_effect(Relaxation(2e4))
    model = Model(MESH, scene)
    state = random_state(model, 3)
    rest = np.concatenate([np.zeros(2 * MESH.size), np.full(MESH.size, 1000.0)])
    state = rest + 1e-3 * (state - rest)
    last = advance(name, model, model.device_mesh.upload(state), 400.0, 400.0 * 400).state.numpy()
    assert np.abs(last - rest).max() < 1e-4 * np.abs(state - rest).max()


@pytest.mark.parametrize("name", IMPLICIT)
@pytest.mark.thorough
def test_mass_follows_relaxation(name: str) -> None:
    """It is not that of the right-hand side any more: the mean depth goes to equilibrium."""
    model = Model(MESH, make_scene("pressure", "rotation").with_effect(Relaxation(1e4)))
    start = model.initial_state().numpy()
    start[-MESH.size :] += 100.0
    last = advance(name, model, model.device_mesh.upload(start), 250.0, 5e3, **tight(name))
    mean = np.average(last.state.numpy()[-MESH.size :], weights=MESH.area)
    assert mean == pytest.approx(1000.0 + 100.0 * np.exp(-0.5), abs=1.0)


@pytest.mark.thorough
def test_spectrum_has_drag_and_relaxation() -> None:
    """r + 2c|v| along the fastest wind, and one over the time of relaxation."""
    for scene, expected in (
        (make_scene("pressure").with_effect(Drag(linear=3e-4)), 3e-4),
        (make_scene("pressure").with_effect(Relaxation(1e4)), 1e-4),
        (make_scene("pressure").with_effect(Drag(quadratic=1e-5)), 2e-5 * 30.0),
        (make_scene("wind").with_effect(Relaxation(1e4)), 1e-4),
    ):
        model = Model(MESH, scene)
        state = random_state(model)
        if model.names != ("h",):
            u, v = state.reshape(3, -1)[:2]
            state[: 2 * MESH.size] *= 30.0 / np.hypot(u, v).max()
        spectrum = model.spectral_radii(model.device_mesh.upload(state))
        assert spectrum.dissipation == pytest.approx(expected, rel=0.02)
        assert spectrum.wave > 0.0


@pytest.mark.thorough
def test_explicit_spectrum_of_semi_implicit_steppers_has_drag_too() -> None:
    model = Model(MESH, make_scene("pressure").with_effect(Drag(quadratic=1e-5)))
    state = random_state(model)
    u, v = state.reshape(3, -1)[:2]
    spectrum = STEPPERS["semi-implicit"].spectral_radii(model, model.device_mesh.upload(state))
    assert spectrum.dissipation == pytest.approx(2e-5 * np.hypot(u, v).max(), rel=0.02)


def test_user_switches_drag_and_relaxation_on_and_off() -> None:
    scene = get_scene("williamson5")
    slow = apply_settings(scene, ["drag.linear=1e-6", "relaxation.time=1e6"])
    assert slow.effects == (*scene.effects, Drag(1e-6), Relaxation(1e6))
    mesh = Mesh.build(2, 4)
    initial = scene.initial(mesh.lon, mesh.lat)[2]
    np.testing.assert_array_equal(slow.equilibrium(mesh.lon, mesh.lat), initial)
    both = apply_settings(slow, ["drag.quadratic=1e-8"])
    assert both.effect("drag") == Drag(1e-6, 1e-8)
    assert apply_settings(slow, ["drag.linear=0", "relaxation.time=inf"]) == scene
    assert slow.without_effect("relaxation").without_effect("drag") == scene
    own = make_scene("relaxation")
    assert own.with_effect(Relaxation(5.0)).equilibrium == own.equilibrium


def test_a_prescribed_wind_has_no_drag() -> None:
    with pytest.raises(ConfigError, match="cannot be slowed down"):
        apply_settings(get_scene("williamson1"), ["drag.linear=1e-6"])
