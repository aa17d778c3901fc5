"""Forcing: an exact solution of the discrete equations is made, and every stepper must find it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from cartesian import Cartesian
from manufactured import DURATION, MESH, STEPS, answer, manufactured, tight
from support import IMPLICIT, advance, make_scene, random_state, relative, some, tangent, tendency

from swe_sphere.equations.effects import Forcing
from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.leapfrog import Leapfrog

DYNAMICS = ("advection", "pressure", "rotation", "orography")


@pytest.fixture(scope="module")
def model() -> Model:
    return Model(MESH, manufactured(*DYNAMICS))


@pytest.mark.parametrize("name", STEPPERS)
@pytest.mark.thorough
def test_every_stepper_keeps_its_order_with_unsteady_forcing(model, name, monkeypatch) -> None:
    """Forcing of wind and depth, taken at the times of the stages; the filters switched off."""
    monkeypatch.setattr(Leapfrog, "default_strength", 0.0)
    exact, scale = answer(DURATION), np.repeat([10.0, 10.0, 100.0], MESH.size)
    errors = []
    for halving in range(3):
        dt = STEPS.get(name, 450.0) / 2**halving
        last = advance(name, model, model.initial_state(), dt, DURATION, **tight(name))
        errors.append(float(np.abs((last.state.numpy() - exact) / scale).max()))
    assert errors[-1] < 0.03
    for coarse, fine in pairwise(errors):
        assert np.log2(coarse / fine) == pytest.approx(STEPPERS[name].order, abs=0.2)


@pytest.mark.parametrize("name", STEPPERS)
def test_forcing_is_not_asked_for_before_the_start(name: str) -> None:
    """It need not be known there: no formula has to hold for negative times."""
    times = []

    def forcing(lon, lat, t):
        times.append(t)
        return 1e-5 * np.cos(lat) * np.sqrt(t / 3600.0), 0.0 * lat, 0.0 * lat

    scene = replace(make_scene(*DYNAMICS, "forcing"), forcing=forcing)
    advance(name, made := Model(MESH, scene), made.initial_state(), 300.0, 600.0)
    assert min(times) == 0.0 and len(set(times)) > 1


@pytest.mark.parametrize("name", some(IMPLICIT))
def test_mass_is_that_of_the_forcing_whatever_the_tolerance(model, name) -> None:
    means = [
        np.average(last.state.numpy()[-MESH.size :], weights=MESH.area)
        for tolerance in (1e-1, 1e-10)
        if (last := advance(name, model, model.initial_state(), 900.0, 5400.0, tolerance=tolerance))
    ]
    assert means[0] == pytest.approx(means[1], rel=1e-13)
    assert abs(means[0] - 2000.0) > 1.0


def test_solid_inflow_raises_the_mean_depth_by_what_flows_in() -> None:
    """Depth that rises everywhere by 1 cm a minute is 60 cm higher after an hour."""
    scene = replace(
        make_scene("wind", "forcing"), forcing=lambda lon, lat, t: (0.0, 0.0, 0.01 / 60.0 + 0.0 * t)
    )
    model = Model(MESH, scene)
    for name in ("rk4", "leapfrog", "tr-bdf2"):
        last = advance(name, model, model.initial_state(), 300.0, 3600.0).state.numpy()
        assert np.average(last, weights=MESH.area) == pytest.approx(1000.6, rel=1e-12)


@pytest.mark.parametrize("shape", ["element", pytest.param("node", marks=pytest.mark.thorough)])
@pytest.mark.parametrize(
    "names",
    [
        ("forcing",),
        ("pressure", "forcing"),
        (*DYNAMICS, "forcing", "viscosity"),
        ("wind", "forcing"),
        ("wind", "forcing", "hyperviscosity"),
    ],
    ids="+".join,
)
def test_forcing_is_added_to_the_rest(small_mesh, names, shape) -> None:
    scene = make_scene(*names)
    model, check = Model(small_mesh, scene, shape=shape), Cartesian(small_mesh, scene)
    state, direction = random_state(model), random_state(model, seed=2)
    blocks = len(model.names)
    for t in (0.25, 4000.0):
        assert relative(tendency(model, state, t), check.tendency(state, t), blocks) < 1e-12
    product = check.tendency(state + 1e-30j * direction).imag / 1e-30
    assert relative(tangent(model, state, direction), product, blocks) < 1e-12


def test_forcing_belongs_to_the_conservative_part(small_mesh) -> None:
    """Once: dissipation, which some schemes add apart, does not have it too."""
    model = Model(small_mesh, make_scene("pressure", "forcing", "viscosity"))
    state = model.device_mesh.upload(random_state(model))
    whole, dynamics, dissipation = (model.zeros() for _ in range(3))
    model.tendency(state, 500.0, whole)
    model.conservative_tendency(state, 500.0, dynamics)
    model.dissipative_tendency(state, dissipation)
    assert relative(dynamics.numpy() + dissipation.numpy(), whole.numpy(), 3) < 1e-12


@pytest.mark.parametrize("steady", [False, True])
def test_forcing_is_evaluated_when_the_time_changes(small_mesh, steady: bool) -> None:
    times = []

    def forcing(lon, lat, t):
        times.append(t)
        return 0.0 * lon, 0.0 * lon, np.full_like(lon, t)

    scene = replace(make_scene("pressure", "forcing"), forcing=forcing, steady_forcing=steady)
    model = Model(small_mesh, scene)
    state = random_state(model)
    last = [tendency(model, state, t)[-1] for t in (0.0, 0.0, 1.0, 1.0, 0.0)]
    assert times == ([0.0] if steady else [0.0, 1.0, 0.0])
    assert last[2] - last[0] == pytest.approx(0.0 if steady else 1.0)
    assert last[0] == last[1] == last[4]
    assert scene.autonomous is steady


def test_steady_scenes_have_no_derivative_in_time() -> None:
    changing, steady = make_scene("wind"), replace(make_scene("wind"), steady_wind=True)
    assert make_scene("pressure").autonomous and steady.autonomous
    assert not changing.autonomous and not make_scene("forcing").autonomous
    forced = replace(steady, effects=(*steady.effects, Forcing()), forcing=lambda lon, lat, t: None)
    assert not forced.autonomous


def test_forcing_and_its_function_come_together() -> None:
    with pytest.raises(ConfigError, match="needs the function 'forcing'"):
        replace(make_scene("forcing"), forcing=None)
    with pytest.raises(ConfigError, match="without effect 'forcing'"):
        replace(make_scene("forcing"), effects=())
