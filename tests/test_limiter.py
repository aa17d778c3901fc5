"""The limiter of tracers: bounds and mass, and smooth fields left almost as they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from swe_sphere import Simulation
from swe_sphere.equations.effects import MASSES, Forcing, Relaxation, Tracers
from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError
from swe_sphere.io.integrals import norms
from swe_sphere.mesh import Mesh
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.adaptive import AdaptiveSteps
from swe_sphere.steppers.dirk import TRBDF2
from swe_sphere.testcases import get_scene

from .support import Leak

ROUND = 1e-14
MASS = 1e-13


def limited(scene, limiter=True):
    return scene.with_effect(Tracers(limiter))


def with_cylinders(scene):
    """A scene with the slotted cylinders and the hills of case 4 of the deformational flow."""
    tracers = get_scene("deformational", case=4).tracers
    names = ("slotted_cylinders", "gaussian_hills")
    chosen = {name: tracers[name] for name in names}
    return replace(scene, effects=(*scene.effects, Tracers(True)), tracers=chosen)


def after(model, stepper, steps):
    stepper.start(model.initial_state())
    for _ in range(steps):
        stepper.step()
    return model.fields(stepper.state)


def check(model, fields, names):
    """Bounds of the start and mass."""
    start = model.fields(model.initial_state())
    for name in names:
        q, before = fields[f"q_{name}"], start[f"q_{name}"]
        assert q.min() >= before.min() - ROUND, name
        assert q.max() <= before.max() + ROUND, name
        masses = [model.mesh.area @ state[f"hq_{name}"] for state in (fields, start)]
        assert masses[0] == pytest.approx(masses[1], rel=MASS), name


@pytest.fixture(scope="module")
def mesh():
    return Mesh.build(4, 4)


def noisy(model, strength):
    """The scene's start with an uneven depth and noise on the tracers, as state blocks."""
    random = np.random.default_rng(3).standard_normal((len(model.names), model.mesh.size))
    blocks = model.initial_state().numpy().astype(float).reshape(random.shape)
    factor = 1.0 + 0.01 * random[0]
    blocks *= factor
    blocks[1:] += strength * random[1:]
    return blocks


@pytest.mark.parametrize("shape", ["element", "node"])
@pytest.mark.parametrize("strength", [2.0, 50.0])
def test_noise_is_brought_into_bounds_without_mass(mesh, shape, strength):
    model = Model(mesh, limited(get_scene("deformational")), shape=shape)
    blocks = noisy(model, strength)
    state = model.device_mesh.upload(blocks.ravel())
    model.limiter(state)
    new = state.numpy().reshape(blocks.shape)
    start = model.fields(model.initial_state())
    assert np.array_equal(new[0], blocks[0])
    for k, name in enumerate(model.scene.tracers, start=1):
        q, bounds = new[k] / new[0], start[f"q_{name}"]
        assert bounds.min() - ROUND <= q.min() < q.max() <= bounds.max() + ROUND
        assert mesh.area @ new[k] == pytest.approx(mesh.area @ blocks[k], rel=MASS)


def test_both_launch_shapes_limit_alike(mesh):
    new = []
    for shape in ("element", "node"):
        model = Model(mesh, limited(get_scene("deformational")), shape=shape)
        state = model.device_mesh.upload(noisy(model, 20.0).ravel())
        model.limiter(state)
        new.append(state.numpy())
    assert new[0] == pytest.approx(new[1], rel=1e-12, abs=1e-10)


def test_what_is_within_bounds_stays_to_the_last_bit(mesh):
    model = Model(mesh, limited(get_scene("deformational")))
    inside = noisy(model, 0.0)
    ratios = inside[1:] / inside[0]
    inside[1:] = inside[0] * (0.9 * ratios + 0.1 * ratios.mean(axis=1, keepdims=True))
    state = model.device_mesh.upload(inside.ravel())
    model.limiter(state)
    assert np.array_equal(state.numpy(), inside.ravel())


def test_most_is_settled_in_the_elements_next_by(mesh):
    """A single overshoot is spread over the elements around it and nothing else is touched."""
    model = Model(mesh, limited(get_scene("deformational")))
    blocks = noisy(model, 0.0)
    blocks[2] = 0.5 * blocks[0]
    peak = int(np.argmax(mesh.xyz @ (1.0, 0.3, 0.2)))
    blocks[2, peak] = 1.3 * blocks[0, peak]
    state = model.device_mesh.upload(blocks.ravel())
    model.limiter(state)
    changed = np.flatnonzero(state.numpy().reshape(blocks.shape)[2] != blocks[2])
    around = mesh.nodes[(mesh.nodes == peak).any(axis=(1, 2))]
    assert set(changed) <= set(around.ravel())
    assert changed.size > 4


WIND_STEPPERS = ("rk4", "leapfrog", "ssprk3", "kg5", "tr-bdf2", "bdf2")


@pytest.mark.parametrize("name", WIND_STEPPERS)
def test_cylinders_under_a_given_wind(mesh, name):
    model = Model(mesh, limited(get_scene("deformational", case=4)))
    fields = after(model, STEPPERS[name](model, 1200.0), 12)
    check(model, fields, model.scene.tracers)


FLOW_STEPPERS = ("rk4", "leapfrog", "semi-implicit", "ars343", "gauss-legendre", "bdf2")


@pytest.mark.parametrize("name", FLOW_STEPPERS)
def test_cylinders_in_a_flow_that_changes(mesh, name):
    model = Model(mesh, with_cylinders(get_scene("williamson5")))
    fields = after(model, STEPPERS[name](model, 600.0), 12)
    check(model, fields, model.scene.tracers)


def test_cylinders_with_steps_that_adapt(mesh):
    model = Model(mesh, with_cylinders(get_scene("williamson5")))
    fields = after(model, AdaptiveSteps(TRBDF2(model, 3600.0), 1e-5), 2)
    check(model, fields, model.scene.tracers)


def test_without_limiter_the_cylinders_leave_their_bounds(mesh):
    model = Model(mesh, limited(get_scene("deformational", case=4), False))
    assert model.limiter is None
    q = after(model, STEPPERS["rk4"](model, 1200.0), 12)["q_slotted_cylinders"]
    assert q.min() < 0.05
    assert q.max() > 1.05


@pytest.mark.thorough
def test_single_precision(mesh):
    model = Model(mesh, limited(get_scene("deformational", case=4)), precision="float32")
    q = after(model, STEPPERS["rk4"](model, 1200.0), 6)["q_slotted_cylinders"]
    assert 0.1 - 1e-7 < q.min() < q.max() < 1.0 + 2e-7


def solid_body_errors(limiter, ne):
    """l2 of a Gaussian hill on a background after a day of solid-body flow over cube corners."""
    flow = get_scene("williamson1", alpha=0.7, gaussian=True)

    def exact(lon, lat, t):
        return 0.3 + flow.exact(lon, lat, t)[2] / 1000.0

    scene = replace(
        flow,
        initial=lambda lon, lat: (*flow.wind(lon, lat, 0.0), 1000.0 + 0.0 * lon),
        exact=None,
        effects=(*flow.effects, Tracers(limiter)),
        tracers={"hill": lambda lon, lat: exact(lon, lat, 0.0)},
    )
    mesh = Mesh.build(ne, 4)
    model = Model(mesh, scene)
    steps = 12 * ne
    q = after(model, STEPPERS["rk4"](model, 86400.0 / steps), steps)["q_hill"]
    return norms(mesh.area, q, exact(mesh.lon, mesh.lat, 86400.0))["l2"]


def test_smooth_tracers_keep_their_order():
    errors = {
        limiter: [solid_body_errors(limiter, ne) for ne in (4, 8)] for limiter in (False, True)
    }
    for free, bounded in zip(errors[0], errors[1], strict=True):
        assert bounded < 1.5 * free
    assert errors[1][0] / errors[1][1] > 2.0**2.8


def test_sources_of_depth_have_no_limiter(mesh):
    """They change mixing ratios, so that the initial range is no bound."""

    class Conserving(Leak):
        conserves = MASSES

    def wind_alone(lon, lat, t):
        return 1e-6 + 0.0 * lat, 0.0 * lat, 0.0 * lat

    def depth_too(lon, lat, t):
        return 1e-6 + 0.0 * lat, 0.0 * lat, 1e-3 + 0.0 * lat

    flow = with_cylinders(get_scene("williamson2"))
    scenes = (
        flow.with_effect(Relaxation(1e5)), flow.with_effect(Conserving(1e-5)),
        replace(flow, effects=(*flow.effects, Forcing()), forcing=depth_too),
    )  # fmt: skip
    for scene in scenes:
        with pytest.raises(ConfigError, match="has sources of depth: leave"):
            STEPPERS["rk4"](Model(mesh, scene), 100.0).step()
        with pytest.raises(ConfigError, match="has sources of depth: leave"):
            Simulation(scene, ne=2, np=4)  # before it opens a file
    forced = replace(flow, effects=(*flow.effects, Forcing()), forcing=wind_alone)
    assert Model(mesh, forced).limiter is not None


def test_a_source_that_begins_later_ends_the_run(mesh) -> None:
    """The frames before it remain: the run cannot detect the source earlier."""

    def second_hour(lon, lat, t):
        return 0.0 * lat, 0.0 * lat, 0.2 * np.cos(lat) ** 2 * (3600.0 <= t < 7200.0)

    flow = with_cylinders(get_scene("williamson2"))
    scene = replace(flow, effects=(*flow.effects, Forcing()), forcing=second_hour)
    simulation = Simulation(scene, mesh=mesh, stepper="rk4", dt=900.0)
    summary = simulation.run(days=0.25, progress=False)
    assert "has sources of depth: leave" in summary["reason"] and 0 < summary["steps"] <= 4


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_nan_is_no_mixing_ratio_within_bounds(mesh, precision: str) -> None:
    model = Model(mesh, with_cylinders(get_scene("williamson2")), precision=precision)
    state = model.initial_state().numpy()
    state[-5] = np.nan
    stepper = STEPPERS["rk4"](model, 300.0)
    stepper.start(model.device_mesh.upload(state))
    stepper.step()
    after = stepper.state.numpy()[3 * mesh.size :].reshape(2, -1)
    assert np.isfinite(after[0]).all() and np.isnan(after[1]).any()
