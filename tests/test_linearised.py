"""Linearised dynamics: the derivative at a base flow, whose waves keep a quadratic energy."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from cartesian import Cartesian
from manufactured import DURATION, MESH, STEPS, answer, manufactured, tight
from support import IMPLICIT, advance, make_scene, random_state, relative, some, tangent, tendency

from swe_sphere.equations.effects import LinearisedDynamics, Tracers
from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.solvers.gravity_waves import reference_depth
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.leapfrog import Leapfrog

WAVES = ("advection", "pressure", "rotation", "orography")
DAMPED = (*WAVES, "viscosity", "hyperviscosity", "quadratic-drag", "relaxation")
SETS = (WAVES, DAMPED, ("pressure",), ("pressure", "rotation", "drag"), ("advection", "forcing"))


def base_of(scene, mesh) -> np.ndarray:
    return np.concatenate(scene.base(mesh.lon, mesh.lat))


def about_rest(*names: str, depth: float = 1500.0):
    """Dynamics linearised about rest with a flat surface, over the bottom of the scene."""
    scene = make_scene(*names, "linearised")
    bottom = scene.bottom or (lambda lon, lat: 0.0 * lat)
    return replace(scene, base=lambda lon, lat: (0.0 * lat, 0.0 * lat, depth - bottom(lon, lat)))


@pytest.mark.parametrize("shape", ["element", pytest.param("node", marks=pytest.mark.thorough)])
@pytest.mark.parametrize("names", SETS, ids="+".join)
def test_right_hand_side_and_tangent(small_mesh, names, shape) -> None:
    """At any state: the derivative of the nonlinear equations at the base, by a complex step."""
    scene = make_scene(*names, "linearised")
    model, check = Model(small_mesh, scene, shape=shape), Cartesian(small_mesh, scene)
    state, direction = random_state(model), random_state(model, seed=2)
    assert relative(tendency(model, state, 5.0), check.tendency(state, 5.0), 3) < 1e-12
    base = base_of(scene, small_mesh)
    product = check.tendency(base + direction, 5.0) - check.tendency(base, 5.0)
    assert relative(tangent(model, state, direction, 5.0), product, 3) < 1e-11


@pytest.mark.parametrize("names", SETS, ids="+".join)
def test_small_waves_are_those_of_the_whole_model(small_mesh, names) -> None:
    """A difference quotient of the nonlinear model about the base, of second order in its width."""
    scene = make_scene(*names, "linearised")
    whole, linear = Model(small_mesh, make_scene(*names)), Model(small_mesh, scene)
    base, wave = base_of(scene, small_mesh), 0.1 * random_state(whole)
    expected = tendency(linear, base + wave) - tendency(linear, base)
    errors = []
    for e in (0.1, 0.01):
        plus, minus = (tendency(whole, base + s * e * wave) for s in (1.0, -1.0))
        errors.append(relative((plus - minus) / (2.0 * e), expected, 3))
    assert errors[1] < (1e-4 if "quadratic-drag" in names else 1e-9)


def test_the_base_does_not_move(small_mesh) -> None:
    """To the last bit, though it is no steady flow of the whole equations."""
    scene = make_scene(*DAMPED, "linearised")
    base = base_of(scene, small_mesh)
    assert not tendency(Model(small_mesh, scene), base).any()
    assert tendency(Model(small_mesh, make_scene(*DAMPED)), base).any()


@pytest.mark.parametrize("names", [("pressure",), WAVES, ("pressure", "rotation")], ids="+".join)
def test_waves_about_rest_keep_their_energy_and_mass(small_mesh, names) -> None:
    """E = sum of area (H |v|²/2 + g η²/2), H the depth at rest: dE/dt is 0 but for round-off."""
    scene = about_rest(*names)
    model, mesh = Model(small_mesh, scene), small_mesh
    state, base = random_state(model), base_of(scene, mesh)
    u, v, eta = (state - base).reshape(3, -1)
    du, dv, dh = tendency(model, state).reshape(3, -1)
    g, rest = scene.planet.gravity, base[-mesh.size :]
    terms = mesh.area * np.stack([rest * u * du, rest * v * dv, g * eta * dh])
    assert abs(terms.sum()) < 1e-13 * np.abs(terms).sum()
    assert abs(np.sum(mesh.area * dh)) < 1e-13 * np.sum(mesh.area * np.abs(dh))


@pytest.mark.parametrize("name", ["implicit-midpoint", "crank-nicolson", "average-vector-field"])
def test_steppers_without_damping_keep_the_quadratic_energy(name: str) -> None:
    """Of waves so high that the whole equations would dry out; one Newton iteration a step."""
    scene = about_rest("pressure", "rotation")
    model = Model(MESH, scene)
    base = base_of(scene, MESH)
    eta = 4000.0 * np.cos(MESH.lat) * np.sin(MESH.lon)
    start = base + np.concatenate([np.zeros(2 * MESH.size), eta])
    assert start.min() < -1000.0

    def energy(state):
        u, v, eta = (state - base).reshape(3, -1)
        return np.sum(MESH.area * (1500.0 * (u**2 + v**2) + scene.planet.gravity * eta**2))

    last = advance(name, model, model.device_mesh.upload(start), 1800.0, 36000.0, tolerance=1e-10)
    assert last.counters["rejected_steps"] == 0
    assert energy(last.state.numpy()) == pytest.approx(energy(start), rel=1e-8)


def test_a_linear_wave_may_undershoot_zero_depth() -> None:
    """Which is no reason to end the run."""
    scene = make_scene(*WAVES, "linearised")

    def initial(lon, lat):
        u, v, h = scene.base(lon, lat)
        return u, v, h + 3000.0 * np.sin(lat)

    sim = Simulation(replace(scene, initial=initial), mesh=MESH, dt=600.0)
    assert sim.initial_fields["h"].min() < -1000.0
    assert sim.run(days=0.25).completed


@pytest.mark.parametrize("name", some(IMPLICIT))
def test_newton_converges_at_once(name: str) -> None:
    """One iteration a solve, however large the amplitude; and the waves grow with it."""
    scene = make_scene(*WAVES, "linearised")
    model = Model(MESH, scene)
    base, rng = base_of(scene, MESH), np.random.default_rng(4)
    wave = np.concatenate(
        [rng.standard_normal(2 * MESH.size), 10.0 * rng.standard_normal(MESH.size)]
    )
    steps, waves, iterations = 2, [], []
    solves = {"tr-bdf2": 2, "sdirk3": 3, "esdirk4": 5, "bdf2": 1.5}.get(name, 1) * steps
    for amplitude in (1.0, 1000.0):
        start = model.device_mesh.upload(base + amplitude * wave)
        last = advance(name, model, start, 900.0, 900.0 * steps, tolerance=1e-6)
        assert last.counters["newton_iterations"] == solves
        iterations.append(last.counters["krylov_iterations"])
        waves.append((last.state.numpy() - base) / amplitude)
    assert relative(waves[0], waves[1], 3) < 1e-4
    assert iterations[1] == pytest.approx(iterations[0], abs=2)  # one preconditioner fits both


@pytest.mark.parametrize("name", STEPPERS)
@pytest.mark.thorough
def test_every_stepper_keeps_its_order(name: str, monkeypatch) -> None:
    """On a made solution, with forcing beside the linearised dynamics."""
    monkeypatch.setattr(Leapfrog, "default_strength", 0.0)
    model = Model(MESH, manufactured("advection", "pressure", "rotation", "linearised"))
    exact, scale, errors = answer(DURATION), np.repeat([10.0, 10.0, 100.0], MESH.size), []
    for halving in range(2):
        dt = STEPS.get(name, 450.0) / 2**halving
        last = advance(name, model, model.initial_state(), dt, DURATION, **tight(name))
        errors.append(float(np.abs((last.state.numpy() - exact) / scale).max()))
    for coarse, fine in pairwise(errors):
        assert np.log2(coarse / fine) == pytest.approx(STEPPERS[name].order, abs=0.2)


def test_depths_of_reference_are_those_of_the_base() -> None:
    scene = about_rest("pressure", depth=777.0)
    assert reference_depth(Model(MESH, scene)) == pytest.approx(777.0)


def test_what_does_not_go_together() -> None:
    with pytest.raises(ConfigError, match="needs the function 'base'"):
        replace(make_scene("pressure"), effects=(LinearisedDynamics(),))
    with pytest.raises(ConfigError, match="leave out linearised"):
        make_scene("wind", "linearised")
    scene = make_scene("pressure", "linearised")
    with pytest.raises(ConfigError, match="tracers need the whole dynamics"):
        replace(scene, effects=(*scene.effects, Tracers()), tracers={"q": lambda lon, lat: lat})
