"""Passive tracers: carried exactly as depth is, in every stepper, on files and in numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from swe_sphere import Simulation
from swe_sphere.equations.effects import Orography, Tracers, Viscosity
from swe_sphere.equations.model import Model
from swe_sphere.equations.scene import apply_settings
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.operators.diagnose import divergence
from swe_sphere.solvers.gravity_waves import GravityWaves
from swe_sphere.steppers import STEPPERS
from swe_sphere.testcases import get_scene

from .support import EXPLICIT, make_scene

CONSTANT = 0.7
FLOW = ("advection", "pressure", "rotation", "orography")
ROUND = 1e-13


def with_tracers(scene, **formulas):
    """The scene with tracers of these mixing ratios, by default a constant and a smooth one."""
    formulas = formulas or {"even": lambda lon, lat: CONSTANT + 0.0 * lon, "wave": wave}
    return replace(scene, effects=(*scene.effects, Tracers()), tracers=formulas)


def wave(lon, lat):
    return 2.0 + np.cos(lat) * np.cos(lon) + np.sin(lat) ** 2


@pytest.fixture(scope="module")
def mesh():
    return Mesh.build(3, 4, centre=(17.0, 11.0), spin=6.0)


def rough(model, seed=0):
    """Random winds [m s-1], depths about 1000 m and mixing ratios about 1, as state blocks."""
    random = np.random.default_rng(seed).standard_normal((len(model.names), model.mesh.size))
    depth = 1000.0 + 30.0 * random[-len(model.scene.tracers) - 1]
    winds = 10.0 * random[: model.fluid_size // model.mesh.size - 1]
    masses = depth * (1.0 + 0.1 * random[-len(model.scene.tracers) :])
    masses[0] = CONSTANT * depth
    return np.concatenate([winds, depth[None], masses])


def tendency(model, blocks, t=0.0):
    out = model.zeros()
    model.tendency(model.device_mesh.upload(blocks.ravel()), t, out)
    return out.numpy().reshape(blocks.shape)


@pytest.mark.parametrize("shape", ["element", pytest.param("node", marks=pytest.mark.thorough)])
@pytest.mark.parametrize(
    "effects",
    [FLOW, ("wind",), (*FLOW, "viscosity", "hyperviscosity"), ("wind", "viscosity")],
    ids=" ".join,
)
def test_constant_mixing_ratio_has_the_tendency_of_the_depth(mesh, effects, shape):
    model = Model(mesh, with_tracers(make_scene(*effects)), shape=shape)
    rate = dict(zip(model.names, tendency(model, rough(model)), strict=True))
    difference = rate["hq_even"] - CONSTANT * rate["h"]
    assert np.abs(difference).max() < ROUND * np.abs(rate["h"]).max()
    assert np.abs(rate["hq_wave"] - rate["h"]).max() > 1e-3 * np.abs(rate["h"]).max()


@pytest.mark.thorough
def test_four_tracers_diffuse_alike_in_both_launch_shapes(mesh) -> None:
    """Fluxes of a thread a node have room apart from what elements leave of four fields."""
    formulas = {f"q{k}": lambda lon, lat, k=k: k + wave(lon, lat) for k in range(4)}
    scene = with_tracers(make_scene(*FLOW, "viscosity"), **formulas)
    models = [Model(mesh, scene, shape=shape) for shape in ("element", "node")]
    by_group, by_node = (tendency(model, rough(model)) for model in models)
    scale = np.abs(by_group).max(axis=1, keepdims=True)
    assert (np.abs(by_node - by_group) / scale).max() < ROUND
    nodal = models[1].device_mesh
    assert nodal.fluxes.ptr != nodal.scratch(4, nodal.real).values.ptr


@pytest.mark.parametrize("shape", ["element", "node"])
def test_transport_is_minus_the_divergence_of_the_mass_flux(mesh, shape):
    model = Model(mesh, with_tracers(make_scene(*FLOW)), shape=shape)
    blocks = rough(model)
    u, v, _, _, mass = blocks
    expected = -divergence(mesh, mass * u, mass * v)
    assert tendency(model, blocks)[-1] == pytest.approx(expected, rel=1e-11, abs=1e-12)


@pytest.mark.parametrize("shape", ["element", "node"])
def test_diffusion_of_tracers_vanishes_for_an_even_surface_and_an_even_ratio(mesh, shape):
    scene = with_tracers(make_scene("advection", "pressure", "orography", "viscosity"))
    model = Model(mesh, scene, shape=shape)
    blocks = np.zeros((5, mesh.size))
    blocks[2] = 1000.0 - model.bottom
    blocks[3:] = CONSTANT * blocks[2], 2.0 * CONSTANT * blocks[2]
    out, quiet = model.zeros(), model.device_mesh.upload(blocks.ravel())
    model.dissipative_tendency(quiet, out)
    scale = 1e6 / mesh.spacing()[0] ** 2 * 1000.0
    assert np.abs(out.numpy()).max() < 1e-11 * scale
    blocks[3] *= wave(mesh.lon, mesh.lat)
    model.dissipative_tendency(model.device_mesh.upload(blocks.ravel()), out)
    rate = out.numpy().reshape(blocks.shape)
    assert np.abs(rate[4]).max() < 1e-11 * scale < 1e-4 * np.abs(rate[3]).max()
    assert mesh.area @ rate[3] == pytest.approx(0.0, abs=1e-12 * mesh.area @ np.abs(rate[3]))


@pytest.mark.parametrize("shape", ["element", pytest.param("node", marks=pytest.mark.thorough)])
@pytest.mark.parametrize(
    "effects", [FLOW, ("wind", "viscosity"), (*FLOW, "viscosity", "hyperviscosity")], ids=" ".join
)
def test_tangent_is_the_derivative(mesh, effects, shape):
    model = Model(mesh, with_tracers(make_scene(*effects)), shape=shape)
    base, direction = rough(model), rough(model, 1)
    direction[-3:] -= direction[-3:].mean()
    small, out = 1e-3, model.zeros()
    slopes = [tendency(model, base + sign * small * direction) for sign in (1.0, -1.0)]
    jacobian = model.jacobian().update(model.device_mesh.upload(base.ravel()), 0.0)
    jacobian(model.device_mesh.upload(direction.ravel()), out)
    expected = (slopes[0] - slopes[1]) / (2.0 * small)
    for mine, theirs in zip(out.numpy().reshape(base.shape), expected, strict=True):
        assert np.abs(mine - theirs).max() < 1e-7 * np.abs(theirs).max()


def stepped(model, name, dt, steps, state=None):
    stepper = STEPPERS[name](model, dt)
    stepper.start(model.initial_state() if state is None else state)
    for _ in range(steps):
        stepper.step()
    return stepper


@pytest.mark.parametrize("name", STEPPERS)
def test_steppers_keep_a_constant_mixing_ratio_and_the_mass(mesh, name):
    scene = with_tracers(get_scene("williamson5")).with_effect(Viscosity(1e5))
    model = Model(mesh, scene)
    dt = 600.0 if name in EXPLICIT else 3600.0
    stepper = stepped(model, name, dt, 5)
    then, now = model.fields(model.initial_state()), model.fields(stepper.state)
    assert np.abs(now["q_even"] - CONSTANT).max() < ROUND
    assert np.abs(now["h"] - then["h"]).max() > 1.0
    for field in ("h", "hq_even", "hq_wave"):
        assert mesh.area @ now[field] == pytest.approx(mesh.area @ then[field], rel=1e-13)


def test_steppers_agree_on_a_tracer(mesh):
    model = Model(mesh, with_tracers(get_scene("williamson2", alpha=0.7)))
    reference = model.fields(stepped(model, "rk4", 300.0, 48).state)["q_wave"]
    start = model.fields(model.initial_state())["q_wave"]
    for name in set(STEPPERS) - {"implicit-euler"}:
        dt = 300.0 if name in EXPLICIT else 1800.0
        stepper = stepped(model, name, dt, round(14400.0 / dt))
        error = model.fields(stepper.state)["q_wave"] - reference
        assert np.abs(error).max() < 5e-3 * np.abs(reference - start).max(), name


def test_tracers_solve_their_rows_of_the_gravity_waves(mesh):
    """Exactly, but for the solver's residual of the depth times q, and a mass that this moves."""
    model, tau = Model(mesh, with_tracers(get_scene("williamson5"))), 1800.0
    waves = GravityWaves(model)
    waves.setup(tau)
    state = model.initial_state()
    waves.linearise(state)
    r, x, linear = model.device_mesh.upload(rough(model).ravel()), model.zeros(), model.zeros()
    guess = model.device_mesh.upload(np.zeros(mesh.size))
    assert waves.solve(r, guess, x, 1e-2).converged
    waves.apply(x, linear)
    rows = [vector.numpy().reshape(5, -1)[2:] for vector in (r, x, linear)]
    residuals = rows[1] - tau * rows[2] - rows[0]
    q = wave(mesh.lon, mesh.lat)
    scale = np.abs(tau * rows[2]).max()
    assert np.abs(residuals[0]).max() > 1e-6 * scale
    left = residuals[2] - q * residuals[0]
    assert np.ptp(left) < 1e-11 * scale
    assert mesh.area @ rows[1][2] == pytest.approx(mesh.area @ rows[0][2], rel=1e-13)
    expected = -divergence(mesh, *(q * waves.depth * x.numpy().reshape(5, -1)[:2]))
    assert rows[2][2] == pytest.approx(expected, rel=1e-9, abs=1e-11 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["rk4", "leapfrog", "semi-implicit", "ars343"])
def test_the_flow_does_not_feel_tracers(mesh, name):
    scene = get_scene("williamson5")
    alone, laden = Model(mesh, scene), Model(mesh, with_tracers(scene))
    states = [stepped(model, name, 600.0, 3).state.numpy() for model in (alone, laden)]
    assert np.array_equal(states[0], states[1][: states[0].size])


def test_a_model_without_tracers_holds_nothing_for_them(mesh):
    model = Model(mesh, get_scene("williamson5"))
    assert model.tracers is None
    assert model.size == model.fluid_size == 3 * mesh.size


@pytest.mark.parametrize("name", ["rk4", "leapfrog", "semi-implicit", "ars343", "tr-bdf2"])
def test_restart_is_bitwise_exact(mesh, name):
    model = Model(mesh, with_tracers(get_scene("williamson5")))
    whole, half = stepped(model, name, 600.0, 6), stepped(model, name, 600.0, 3)
    again = STEPPERS[name](model, 600.0)
    again.load_state_dict(half.state_dict(), half.steps)
    for _ in range(3):
        again.step()
    assert np.array_equal(again.state.numpy(), whole.state.numpy())


@pytest.mark.parametrize("name", ["rk4", "semi-implicit"])
def test_explicit_diffusion_of_tracers_is_stable_over_a_mountain(name):
    """The field q (h + b) is 20 times hq over the summit, whose rates the fluid does not have."""
    peak = replace(
        make_scene(*FLOW, "viscosity"),
        bottom=lambda lon, lat: 3800.0 * np.exp(-20.0 * (1.0 - np.cos(lat) * np.cos(lon))),
        initial=lambda lon, lat: (0.0, 0.0, 4000.0 - peak.bottom(lon, lat)),
    ).with_effect(Viscosity(1e7))
    sim = Simulation(with_tracers(peak), ne=4, np=4, stepper=name)
    assert sim.run(days=1)["status"] == "completed"
    np.testing.assert_allclose(sim.state["q_even"], CONSTANT, rtol=1e-12)
    assert 1.0 < sim.state["q_wave"].min() < sim.state["q_wave"].max() < 4.0


def test_diffusion_of_tracers_does_not_depend_on_the_datum_of_the_bottom(mesh):
    scene = with_tracers(make_scene(*FLOW, "viscosity"))
    lower = replace(scene, bottom=lambda lon, lat: scene.bottom(lon, lat) - 5000.0)
    blocks = rough(model := Model(mesh, scene))
    expected, found = tendency(model, blocks), tendency(Model(mesh, lower), blocks)
    np.testing.assert_allclose(found[3:], expected[3:], rtol=1e-8, atol=1e-10)


def test_diffusion_of_tracers_over_a_bottom_is_not_linear():
    scene = with_tracers(make_scene("wind", "viscosity"))
    assert scene.linear
    over = replace(scene, effects=(*scene.effects, Orography()), bottom=lambda lon, lat: 0.0 * lon)
    assert not over.linear


def test_settings_reach_the_tracers():
    scene = with_tracers(get_scene("williamson5"))
    assert apply_settings(scene, ["tracers.limiter=true"]).effect("tracers") == Tracers(True)
    with pytest.raises(ConfigError, match=r"tracers\.limiter must be true or false, got '2'"):
        apply_settings(scene, ["tracers.limiter=2"])
    with pytest.raises(ConfigError, match="has no effect 'tracers'"):
        apply_settings(get_scene("williamson5"), ["tracers.limiter=true"])


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"tracers": {}}, "at least one tracer"),
        ({"tracers": {"a b": wave}}, "got 'a b'"),
        ({"tracers": None}, "needs the function 'tracers'"),
        ({"effects": get_scene("williamson5").effects}, "without effect 'tracers'"),
    ],
)
def test_scenes_with_senseless_tracers_are_refused(changes, complaint):
    scene = with_tracers(get_scene("williamson5"))
    with pytest.raises(ConfigError, match=complaint):
        replace(scene, **changes)


@pytest.mark.parametrize("name", ["rk4", "tr-bdf2"])
def test_mixing_ratios_may_be_as_small_as_numbers_are(name):
    scene = replace(
        with_tracers(make_scene("pressure")), tracers={"trace": lambda lon, lat: 1e-160}
    )
    simulation = Simulation(scene, ne=2, np=4, stepper=name, dt=600.0)
    assert simulation.run(days=0.05, progress=False)["completed"]
    assert simulation.snapshot.fields["q_trace"] == pytest.approx(1e-160, rel=1e-12)
