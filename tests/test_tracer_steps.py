"""Tracers on steps of their own: what they keep, how accurate they are, how long they may be."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from swe_sphere import Simulation
from swe_sphere.equations.effects import MASSES, PointwiseEffect, Tracers, Viscosity
from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError, Unstable
from swe_sphere.io.checkpoint import read_checkpoint, write_checkpoint
from swe_sphere.mesh import Mesh
from swe_sphere.operators.diagnose import divergence
from swe_sphere.operators.tracers import CourantRate, MassSteps, symbol
from swe_sphere.simulation.planning import time_plan
from swe_sphere.steppers import STEPPERS, Stepper
from swe_sphere.steppers.tracer_steps import (
    LONGEST,
    CarriedTracers,
    CarriedWithDepth,
    stages_for,
    tracer_limit,
)  # fmt: skip
from swe_sphere.testcases import get_scene

from .test_tracers import CONSTANT, wave, with_tracers

CARRIERS = ("rk4", "leapfrog", "forward-backward", "fb-rk3", "mis3c", "semi-implicit", "ark2")
ROUND = 1e-13


@pytest.fixture(scope="module")
def mesh():
    return Mesh.build(3, 4, centre=(17.0, 11.0), spin=6.0)


def over_hill(limiter=False):
    """williamson5 with an even tracer and a smooth one."""
    return with_tracers(get_scene("williamson5")).with_effect(Tracers(limiter=limiter))


def stirred(limiter=False, **formulas):
    """The flow of case 3, which diverges, and tracers as above."""
    formulas = formulas or {"even": lambda lon, lat: CONSTANT + 0.0 * lon, "wave": wave}
    scene = replace(get_scene("deformational", case=3), tracers=formulas, exact_tracers=None)
    return scene.with_effect(Tracers(limiter=limiter))


@pytest.fixture(scope="module")
def hill(mesh):
    return Model(mesh, over_hill())


@pytest.fixture(scope="module")
def rough_hill(mesh):
    """With diffusion."""
    return Model(mesh, over_hill().with_effect(Viscosity(nu=1e6)))


def carried(model, name, dt, every, cycles, state=None):
    """A stepper after so many of its long steps."""
    if model.scene.wind is None:
        stepper = CarriedTracers(model, STEPPERS[name](model.flux_model, dt), every)
    else:
        stepper = CarriedWithDepth(model, STEPPERS[name], dt, every)
    stepper.start(model.initial_state() if state is None else state)
    for _ in range(cycles):
        stepper.step()
    return stepper


def l2(mesh, a, b):
    return np.sqrt(mesh.area @ (a - b) ** 2 / mesh.area.sum())


# --- stages


@pytest.mark.parametrize("shape", ["element", "node"])
@pytest.mark.parametrize("count", [1, 5])
def test_a_stage_is_minus_the_divergence_of_what_the_flux_carries(mesh, shape, count):
    model = Model(mesh, over_hill(), shape=shape)
    random, n = np.random.default_rng(0), mesh.size
    upload = model.device_mesh.upload
    u, v = 1e4 * random.standard_normal((2, n))
    depth, masses = 1000.0 + random.random(n), random.random((count, n))
    step = MassSteps(model.device_mesh, (count + 1) * n, n, count, depth=0)
    flux, tau = upload(np.concatenate([u, v])), 7.0
    state = upload(np.concatenate([depth, masses.ravel()]))
    step(flux, state, tau, 1, (1.0,))
    new_depth, *new_masses = state.numpy().reshape(count + 1, n)
    assert new_depth == pytest.approx(depth - tau * divergence(mesh, u, v), rel=1e-11, abs=1e-11)
    for before, after in zip(masses, new_masses, strict=True):
        expected = before - tau * divergence(mesh, before / depth * u, before / depth * v)
        assert after == pytest.approx(expected, rel=1e-11, abs=1e-11)


def test_stages_reach_as_far_as_they_say():
    for reach in np.linspace(0.1, 2.0 * LONGEST, 60):
        parts, fractions = stages_for(reach)
        y = np.linspace(0.0, reach / parts, 2001)
        p = np.ones_like(y, dtype=complex)
        for fraction in fractions:
            p = 1.0 + 1j * y * fraction * p
        assert np.abs(p).max() < 1.0 + 1e-6
        small = y < 0.2
        assert np.abs(p - np.exp(1j * y))[small].max() < 1e-5
    assert stages_for(2.0 * LONGEST)[0] == 2
    assert stages_for(2.0) == (1, (1 / 4, 1 / 3, 1 / 2, 1.0))


def test_rounding_leaves_no_reach_without_stages():
    for parts in range(1, 400):
        reach = parts * LONGEST
        for there in (reach, np.nextafter(reach, np.inf)):
            assert parts <= stages_for(float(there))[0] <= parts + 1


@pytest.mark.parametrize("reach", [1e12, np.inf, np.nan])
def test_a_step_that_would_never_end_is_refused_in_a_line(reach):
    with pytest.raises(Unstable, match=r"parts in a step, more than 1000: .* smaller dt") as error:
        stages_for(reach)
    assert "\n" not in str(error.value)


def test_a_flow_that_blows_up_ends_the_run(hill):
    stepper = CarriedTracers(hill, STEPPERS["rk4"](hill.flux_model, 9000.0), 2)
    stepper.start(hill.initial_state())
    with pytest.raises(Unstable), np.errstate(all="ignore"):
        for _ in range(300):
            stepper.step()


@pytest.mark.parametrize(("np_", "known"), [(3, 1.5), (4, 1.5 * 10**0.5 / 3**0.5)])
def test_symbol_of_the_derivative(np_, known):
    mesh = Mesh.build(2, np_)
    assert symbol(mesh.derivative, mesh.gll_weights) == pytest.approx(known, rel=1e-3)


@pytest.mark.parametrize("shape", ["element", "node"])
def test_speeds_across_elements_bound_the_spectrum(mesh, shape):
    model = Model(mesh, get_scene("deformational"), shape=shape)
    courant = CourantRate(model.device_mesh)
    ones = model.device_mesh.upload(np.ones(mesh.size))
    bound = courant.bound(model.parameters["wind"], ones)
    radius = model.spectral_radii(model.initial_state()).wave
    assert radius < bound < 1.5 * radius
    assert tracer_limit(model) == pytest.approx(2.0 * LONGEST / (1.1 * radius), rel=0.05)


# --- what is kept


@pytest.mark.parametrize("name", CARRIERS)
@pytest.mark.parametrize("which", ["hill", "rough_hill"])
def test_even_tracers_stay_even_and_masses_stay(request, which, name):
    hill = request.getfixturevalue(which)
    mesh, start = hill.mesh, hill.fields(hill.initial_state())
    fields = hill.fields(carried(hill, name, 900.0, 3, 8).state)
    assert np.abs(fields["q_even"] / CONSTANT - 1.0).max() < ROUND
    for tracer in ("hq_even", "hq_wave", "h"):
        assert mesh.area @ fields[tracer] == pytest.approx(mesh.area @ start[tracer], rel=ROUND)
    assert np.abs(fields["q_wave"] - start["q_wave"]).max() > 1e-2


def test_diffusion_of_tracers_is_that_of_short_steps(mesh, rough_hill):
    ends = [rough_hill.fields(carried(rough_hill, "rk4", 900.0, k, 24 // k).state) for k in (1, 6)]
    still = Model(mesh, over_hill())
    without = still.fields(carried(still, "rk4", 900.0, 6, 4).state)
    short, long = (fields["q_wave"] for fields in ends)
    assert l2(mesh, short, long) < 0.02 * l2(mesh, long, without["q_wave"])


def test_the_flow_is_that_of_its_stepper(hill):
    stepper = carried(hill, "rk4", 900.0, 3, 4)
    alone = STEPPERS["rk4"](hill, 900.0)
    alone.start(hill.initial_state())
    for _ in range(12):
        alone.step()
    assert (stepper.steps, stepper.time) == (12, alone.time)
    fluid = slice(0, hill.fluid_size)
    assert np.array_equal(stepper.state.numpy()[fluid], alone.state.numpy()[fluid])


def test_depth_and_tracers_in_a_prescribed_wind_that_diverges(mesh):
    model = Model(mesh, stirred())
    start = model.fields(model.initial_state())
    fields = model.fields(carried(model, "rk4", 3600.0, 4, 6).state)
    assert np.abs(fields["q_even"] / CONSTANT - 1.0).max() < ROUND
    assert np.ptp(fields["h"]) > 50.0
    for tracer in ("hq_wave", "h"):
        assert mesh.area @ fields[tracer] == pytest.approx(mesh.area @ start[tracer], rel=ROUND)


@pytest.mark.parametrize("scene", [over_hill, stirred])
def test_limiter_keeps_bounds_and_masses(mesh, scene):
    model = Model(mesh, scene(limiter=True))
    start = model.fields(model.initial_state())
    fields = model.fields(carried(model, "rk4", 1800.0, 4, 8).state)
    low, high = start["q_wave"].min(), start["q_wave"].max()
    assert low - 1e-12 < fields["q_wave"].min() and fields["q_wave"].max() < high + 1e-12
    mass = mesh.area @ start["hq_wave"]
    assert mesh.area @ fields["hq_wave"] == pytest.approx(mass, rel=ROUND)


def test_winds_that_grow_are_met_by_more_parts(mesh, hill):
    start = hill.initial_state().numpy()
    start[: 2 * mesh.size] *= 8.0
    fast = hill.device_mesh.upload(start)
    every = int(tracer_limit(hill) / 300.0)
    slow_one = carried(hill, "rk4", 300.0, every, 1, None).counters["tracer_stages"]
    fast_one = carried(hill, "rk4", 300.0, every, 1, fast)
    assert fast_one.counters["tracer_stages"] > 4 * slow_one
    assert hill.fields(fast_one.state)["q_wave"].max() < 2.0 * wave(0.0, 0.6)


# --- accuracy


@pytest.mark.parametrize("scene", [over_hill, stirred])
def test_of_second_order_in_the_step_of_the_tracers(mesh, scene):
    model = Model(mesh, scene())
    dt, span = 900.0, 48
    ends = {
        k: model.fields(carried(model, "rk4", dt, k, span // k).state)["q_wave"]
        for k in (1, 2, 4, 8)
    }
    changes = [l2(mesh, ends[k], ends[2 * k]) for k in (1, 2, 4)]
    orders = np.log2(np.divide(changes[1:], changes[:-1]))
    assert orders == pytest.approx(2.0, abs=0.15)


# --- restart


@pytest.mark.parametrize("name", CARRIERS)
def test_restart_is_exact(hill, name):
    whole = carried(hill, name, 900.0, 3, 4)
    part = carried(hill, name, 900.0, 3, 2)
    again = CarriedTracers(hill, STEPPERS[name](hill.flux_model, 900.0), 3)
    again.load_state_dict(part.state_dict(), part.steps)
    for _ in range(2):
        again.step()
    assert again.time == whole.time
    assert np.array_equal(again.state.numpy(), whole.state.numpy())


def test_a_run_goes_on_from_its_file(tmp_path):
    settings = {"ne": 2, "np": 4, "tracer_steps": "auto", "dt": 3600, "every": 12}
    whole = Simulation("deformational", days=2, **settings)
    whole.run(progress=False)
    part = Simulation("deformational", days=1, **settings)
    part.run(out=tmp_path / "part.nc", progress=False)
    assert part.plan.cycle > 2
    again = Simulation.from_checkpoint(tmp_path / "part.nc", days=2)
    again.run(progress=False)
    assert (again.plan.cycle, again.steps) == (whole.plan.cycle, whole.steps)
    assert np.array_equal(again.stepper.state.numpy(), whole.stepper.state.numpy())


# --- plans


@pytest.mark.parametrize("fewer", [False, True])
def test_frames_fall_on_whole_cycles(fewer):
    plan = time_plan(2.0, 10.0, 700.0, cycle=7, fewer=fewer)
    assert plan.steps % plan.cycle == plan.frame_steps % plan.cycle == 0
    assert plan.dt <= 700.0
    assert plan.time(plan.steps) == 2.0 * 86400.0
    assert plan.time(plan.frame_steps) == pytest.approx(36000.0)
    assert plan.cycle == 7 or fewer


def test_callbacks_see_whole_cycles():
    seen = []
    sim = Simulation("deformational", ne=2, np=4, dt=3600, tracer_steps=3, days=1)
    sim.run(callbacks=[lambda sim: seen.append(sim.steps)], progress=False)
    assert seen == [*range(3, 25, 3)]


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"tracer_steps": 500}, "steps of 600 s together"),
        ({"tracer_steps": 2, "stepper": "tr-bdf2"}, "tr-bdf2 includes tracers"),
        ({"tracer_steps": 0}, "tracer-steps: must be a whole number"),
        ({"tracer_steps": "many"}, "tracer-steps: must be a whole number"),
    ],
)
def test_refusals(asked, words):
    with pytest.raises(ConfigError, match=words) as found:
        Simulation("deformational", ne=2, np=4, dt=600, days=1, **asked).begin()
    assert "\n" not in str(found.value)


def test_a_stepper_has_to_say_which_states_it_remembers(hill):
    """Tracers would lose what has crossed since, silently."""

    class Untold(STEPPERS["leapfrog"]):
        levels = Stepper.levels

    carried(hill, "leapfrog", 600.0, 2, 0)
    with pytest.raises(ConfigError, match="leapfrog keeps previous between steps: its `levels`"):
        CarriedTracers(hill, Untold(hill.flux_model, 600.0), 2)


def test_scenes_without_tracers_take_none_of_it():
    with pytest.raises(ConfigError, match="williamson2 has no tracers"):
        Simulation("williamson2", ne=2, np=4, tracer_steps=2).begin()
    sim = Simulation("williamson2", ne=2, np=4, tracer_steps="auto", days=1)
    sim.begin()
    assert sim.plan.cycle == 1


@pytest.mark.parametrize("asked", [1, "auto"])
@pytest.mark.parametrize("scene", ["williamson2", "deformational"])
def test_a_checkpoint_with_impossible_steps_at_once_is_damaged(tmp_path, scene, asked):
    sim = Simulation(scene, ne=2, np=4, dt=900.0, tracer_steps=asked)
    sim.step()
    path = sim.checkpoint(tmp_path / "a.npz")
    assert Simulation.from_checkpoint(path).steps == sim.steps
    sound = read_checkpoint(path)
    write_checkpoint(path, replace(sound, attributes=sound.attributes | {"steps_at_once": 5000}))
    with pytest.raises(ConfigError, match=r"a\.npz is damaged: steps_at_once=5000"):
        Simulation.from_checkpoint(path)


@dataclass(frozen=True)
class Pump(PointwiseEffect):
    """Moves fluid from the south to the north, without a change of the mass."""

    name = "pump"
    conserves = MASSES
    rate: float = 1e-3

    def coefficients(self, mesh):
        return {"pattern": self.rate * np.sin(mesh.lat)}

    @staticmethod
    def depth_tendency(c, i, u, v, h):
        return c.pattern[i]


@dataclass(frozen=True)
class Push(PointwiseEffect):
    """Accelerates the wind alone."""

    name = "push"
    rate: float = 1e-6

    @staticmethod
    def wind_tendency(c, i, u, v, h):
        return c.rate * u, c.rate * v


@pytest.mark.parametrize("name", ["deformational", "williamson2"])
def test_effects_on_the_depth_allow_no_separate_tracer_steps(name: str) -> None:
    scene = get_scene(name)
    if not scene.tracers:
        tracers = {"a": lambda lon, lat: 1.0 + 0.5 * np.cos(lon) * np.cos(lat)}
        scene = replace(scene, effects=(*scene.effects, Tracers()), tracers=tracers)
    pumped = Simulation(scene, ne=2, np=4, dt=600.0, effects=[Pump()], tracer_steps="auto")
    assert pumped.run(days=0.1, progress=False).completed and pumped.plan.cycle == 1
    with pytest.raises(ConfigError, match="has sources of depth"):
        Simulation(scene, ne=2, np=4, dt=600.0, effects=[Pump()], tracer_steps=2).begin()
    if scene.wind is None:
        pushed = Simulation(scene, ne=2, np=4, dt=600.0, effects=[Push()], tracer_steps=2)
        assert pushed.run(days=0.1, progress=False).completed and pushed.plan.cycle == 2
