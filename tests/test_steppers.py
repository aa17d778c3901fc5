"""Explicit steppers: order, conservation, exact restart."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from support import EXPLICIT, harmonic, make_scene, random_state, relative

from swe_sphere.equations.effects import Viscosity
from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError
from swe_sphere.io.integrals import flow_integrals
from swe_sphere.mesh import Mesh
from swe_sphere.steppers import STEPPERS, get_stepper
from swe_sphere.testcases import get_scene


def advance(name: str, model: Model, state, dt: float, duration: float, **options):
    """A stepper after `duration` [s]."""
    stepper = get_stepper(name)(model, dt, **options)
    stepper.start(state)
    for _ in range(round(duration / dt)):
        stepper.step()
    return stepper


@pytest.fixture(scope="module")
def moving():
    """The unsteady flow of Läuter, its state, and the state after four hours in tiny steps."""
    model = Model(Mesh.build(3, 4), get_scene("lauter"))
    state = model.initial_state()
    return model, state, advance("rk4", model, state, 30.0, 14400.0).state.numpy()


def orders(moving, name: str, steps, **options) -> list[float]:
    """Orders found from successive halvings of the time step, by the error of the whole state."""
    model, state, reference = moving
    scale = np.repeat(np.abs(reference).reshape(3, -1).max(axis=1), model.mesh.size)
    weight = np.tile(model.mesh.area, 3) / scale**2
    errors = []
    for dt in steps:
        end = advance(name, model, state, dt, 14400.0, **options).state.numpy()
        errors.append(np.sqrt(np.sum(weight * (end - reference) ** 2)))
    return [float(np.log2(coarse / fine)) for coarse, fine in pairwise(errors)]


@pytest.mark.parametrize("name", ["rk4", "ssprk3", "kg5", "forward-backward", "fb-rk3"])
def test_order_by_three_halvings(moving, name: str) -> None:
    for order in orders(moving, name, (800.0, 400.0, 200.0, 100.0)):
        assert order == pytest.approx(STEPPERS[name].order, abs=0.15)


def test_leapfrog_without_its_filter_is_of_second_order(moving) -> None:
    for order in orders(moving, "leapfrog", (400.0, 200.0, 100.0, 50.0), strength=0.0):
        assert order == pytest.approx(2.0, abs=0.15)


def test_leapfrog_filter_leaves_first_order_in_the_limit(moving) -> None:
    """The filter damps by a part of ν (2α - 1) (ω Δt)² a step: first order over a given time."""
    found = orders(moving, "leapfrog", (400.0, 200.0, 100.0, 50.0))
    assert found == pytest.approx([1.0] * 3, abs=0.15)
    kind, (model, *_) = STEPPERS["leapfrog"], moving
    assert [kind.order_in(model, strength=s) for s in (None, 0.1, 0.0)] == [1, 1, 2]


@pytest.mark.parametrize(
    ("strength", "share", "options"),
    [(0.1, 0.7, {}), (0.04, 1.0, {"strength": 0.04, "share": 1.0}), (0.0, 0.7, {"strength": 0.0})],
)
def test_leapfrog_filters_as_williams_does(small_mesh, strength, share, options) -> None:
    """Williams (2009), eqs. 7-9, ν = 0.1, α = 0.7, with drag from the filtered past."""
    model = Model(small_mesh, make_scene("advection", "pressure", "rotation", "drag"))
    stepper, dt = STEPPERS["leapfrog"](model, 200.0, **options), 200.0
    past = random_state(model)
    first = advance("rk4", model, model.device_mesh.upload(past), dt, dt)
    stepper.start(model.device_mesh.upload(past))
    now, rate, loss = first.state.numpy(), model.zeros(), model.zeros()
    stepper.step()
    for _ in range(5):
        model.conservative_tendency(model.device_mesh.upload(now), 0.0, rate)
        model.dissipative_tendency(model.device_mesh.upload(past), loss)
        future = past + 2.0 * dt * (rate.numpy() + loss.numpy())
        displacement = 0.5 * strength * (past - 2.0 * now + future)
        past, now = now + share * displacement, future - (1.0 - share) * displacement
        stepper.step()
        assert relative(stepper.state.numpy(), now, 3) < 1e-12


@pytest.mark.parametrize("name", EXPLICIT)
def test_mass_is_kept_to_round_off(name: str) -> None:
    model = Model(Mesh.build(3, 4), get_scene("williamson5"))
    state = model.initial_state()
    after = advance(name, model, state, 200.0, 40000.0).state
    before, now = (np.sum(model.mesh.area * model.fields(x)["h"]) for x in (state, after))
    assert abs(now / before - 1.0) < 1e-13


def test_energy_drift_of_rk4_falls_with_the_fifth_power() -> None:
    """|R(iz)| = 1 - z⁶/144: the loss over a given time is of order 5 in Δt."""
    model = Model(Mesh.build(8, 4), get_scene("williamson6"))
    state = model.initial_state()
    start = energy(model, state)
    steps = (400.0, 200.0, 100.0)
    drifts = [
        abs(energy(model, advance("rk4", model, state, dt, 43200.0).state) / start - 1.0)
        for dt in steps
    ]
    assert drifts[0] < 1e-8
    for coarse, fine in pairwise(drifts):
        assert np.log2(coarse / fine) == pytest.approx(5.0, abs=0.4)


def energy(model: Model, state) -> float:
    fields = model.fields(state)
    u, v, h = (fields[name] for name in "uvh")
    return flow_integrals(model.mesh, model.scene.planet, u, v, h, model.bottom)["energy"]


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("name", EXPLICIT)
@pytest.mark.thorough
def test_restart_is_exact_to_the_last_bit(name: str, precision: str) -> None:
    """Interrupted at any step, with dissipation and an odd start time."""
    scene = get_scene("williamson5").with_effect(Viscosity(1e5))
    model = Model(Mesh.build(2, 4), scene, precision=precision)
    whole = STEPPERS[name](model, 300.0)
    whole.start(model.initial_state(), 123.0)
    memories = [whole.state_dict()]
    for _ in range(6):
        whole.step()
        memories.append(whole.state_dict())
    for steps in (0, 1, 4):
        resumed = STEPPERS[name](Model(Mesh.build(2, 4), scene, precision=precision), 300.0)
        resumed.load_state_dict(memories[steps], steps)
        assert resumed.time == 123.0 + 300.0 * steps
        for _ in range(6 - steps):
            resumed.step()
        assert resumed.steps == whole.steps and resumed.time == whole.time
        for key, value in resumed.state_dict().items():
            assert value.tobytes() == memories[-1][key].tobytes(), key


def test_starting_again_forgets_the_past(small_mesh) -> None:
    """A leapfrog stepper that is started twice does the same twice."""
    model = Model(small_mesh, make_scene("advection", "pressure", "rotation"))
    stepper, results = STEPPERS["leapfrog"](model, 60.0), []
    for _ in range(2):
        stepper.start(model.initial_state())
        for _ in range(4):
            stepper.step()
        results.append(stepper.state.numpy().tobytes())
    assert results[0] == results[1]


def test_time_dependent_wind_is_taken_at_the_stages() -> None:
    """With a wind that changes in time rk4 keeps its order only if stages know their time."""
    model = Model(Mesh.build(2, 4), make_scene("wind"))
    rng = np.random.default_rng(0)
    state = model.device_mesh.upload(1000.0 + 100.0 * rng.standard_normal(model.size))
    reference = advance("rk4", model, state, 0.0625, 4.0).state.numpy()
    errors = [
        np.abs(advance("rk4", model, state, dt, 4.0).state.numpy() - reference).max()
        for dt in (1.0, 0.5)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.3)


@pytest.mark.parametrize("name", EXPLICIT)
def test_viscosity_decays_a_harmonic(name: str) -> None:
    """exp(-ν l(l+1)/a² t)."""
    mesh = Mesh.build(2, 8)
    degree, value, _, rotated = harmonic(mesh, "xyz")
    model = Model(mesh, make_scene("viscosity").with_effect(Viscosity(1e7)))
    state = np.concatenate([*(mesh.radius * rotated), value])
    rate = 1e7 * degree * (degree + 1) / mesh.radius**2
    last = advance(name, model, model.device_mesh.upload(state), 400.0, 86400.0).state.numpy()
    assert last @ state / (state @ state) == pytest.approx(np.exp(-rate * 86400.0), rel=2e-3)


def test_bad_steps_and_strange_memories_are_refused(small_mesh) -> None:
    model = Model(small_mesh, make_scene("pressure"))
    for dt in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ConfigError, match="positive and finite"):
            STEPPERS["rk4"](model, dt)
    with pytest.raises(ConfigError, match="leapfrog"):
        other = STEPPERS["rk4"](model, 1.0).state_dict()
        STEPPERS["leapfrog"](model, 1.0).load_state_dict(other, 0)
    with pytest.raises(ConfigError, match="did you mean 'leapfrog'"):
        get_stepper("leap-frog")
