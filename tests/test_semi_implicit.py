"""Semi-implicit leapfrog and implicit-explicit Runge-Kutta: solver, order, stability, restart."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import scipy.sparse as sp
import warp as wp
from support import IMEX, advance, make_scene, random_state, relative, thorough

from swe_sphere import Simulation
from swe_sphere.equations.effects import Viscosity
from swe_sphere.equations.model import Model
from swe_sphere.equations.spectrum import SpectralRadii
from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.mesh import Mesh
from swe_sphere.operators import sparse
from swe_sphere.operators.schur import SchurMatrix
from swe_sphere.planet import Planet
from swe_sphere.solvers.gravity_waves import (
    INERTIAL,
    GravityWaves,
    advection_rate,
    explicit_radii,
    reference_depth,
)
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.leapfrog import Leapfrog
from swe_sphere.steppers.stability import runge_kutta_factor, tableau
from swe_sphere.studies.cases.scenes import thin_flow
from swe_sphere.testcases import get_scene

RUNGE_KUTTA = ("ark2", "ars343")
WAVES = ("advection", "pressure", "rotation", "orography")


# --- the linear operator and its inverse


@pytest.mark.parametrize(
    "precision", ["float64", pytest.param("float32", marks=pytest.mark.thorough)]
)
def test_operator_against_sparse_matrices(small_mesh, precision: str) -> None:
    model = Model(small_mesh, make_scene(*WAVES), precision=precision)
    waves, out = GravityWaves(model), model.zeros()
    x = random_state(model)
    waves.apply(model.device_mesh.upload(x), out)
    u, v, h = np.split(x, 3)
    slope = sparse.gradient(small_mesh) @ h
    slope_u, slope_v = np.split(model.scene.planet.gravity * slope, 2)
    flow = sparse.divergence(small_mesh) @ np.concatenate([waves.depth * u, waves.depth * v])
    expected = np.concatenate([-slope_u, -slope_v, -flow])
    assert relative(out.numpy(), expected, 3) < (1e-12 if precision == "float64" else 1e-4)


@pytest.mark.parametrize("tau", [100.0, 3000.0, 50000.0])
def test_solver_inverts_the_operator(small_mesh, tau: float) -> None:
    model = Model(small_mesh, make_scene(*WAVES))
    waves = GravityWaves(model)
    x, product, found = random_state(model), model.zeros(), model.zeros()
    waves.apply(model.device_mesh.upload(x), product)
    rhs = x - tau * product.numpy()
    waves.setup(tau)
    guess = wp.zeros(small_mesh.size, dtype=wp.float64, device="cpu")
    result = waves.solve(model.device_mesh.upload(rhs), guess, found, 1e-11)
    assert result.converged and result.iterations > 0
    assert relative(found.numpy(), x, 3) < 1e-6
    mass = np.sum(small_mesh.area * (found.numpy() - rhs)[-small_mesh.size :])
    assert abs(mass) < 1e-13 * np.sum(small_mesh.area * np.abs(rhs[-small_mesh.size :]))
    depth = found[2 * small_mesh.size :]
    again = waves.solve(model.device_mesh.upload(rhs), depth, model.zeros(), 1e-11)
    assert again.iterations <= 1, "the guess was not used"


@pytest.mark.parametrize("tau", [100.0, 3000.0, 100000.0])
@pytest.mark.parametrize("tolerance", [1e-1, 1e-3, 2e-5, 1e-7])
def test_residual_of_the_solver_is_within_its_tolerance(
    small_mesh, tolerance: float, tau: float
) -> None:
    """Much is float32 for loose tolerances; the residual is computed by sparse matrices."""
    model = Model(small_mesh, make_scene(*WAVES))
    waves, r, out = GravityWaves(model), random_state(model), model.zeros()
    waves.setup(tau)
    assert waves.solve(model.device_mesh.upload(r), None, out, tolerance).converged
    found, before = (np.split(state, 3)[2] for state in (out.numpy(), r))
    assert abs(small_mesh.area @ (found - before)) < 1e-13 * (small_mesh.area @ np.abs(found))
    assert np.any(found != found.astype(np.float32))
    east, north, depth = np.split(r, 3)
    flow = np.concatenate([waves.depth * east, waves.depth * north])
    b = depth - tau * (sparse.divergence(small_mesh) @ flow)
    s = SchurMatrix(small_mesh, model.scene.planet.gravity, np.zeros(small_mesh.size))
    rest = b - s.matrix(tau, waves.depth) @ found
    size, left = (np.sqrt(np.sum(small_mesh.area * v**2)) for v in (b, rest))
    assert left <= 1.01 * tolerance * size


@pytest.mark.thorough
def test_number_type_of_the_step_changes_no_bits(small_mesh) -> None:
    """A numpy.float64 would turn arrays of float32 into arrays of float64."""
    model = Model(small_mesh, make_scene(*WAVES), precision="float32")
    rhs, found = model.device_mesh.upload(random_state(model)), []
    for number in (float, np.float64):
        solver, out = GravityWaves(model), model.zeros()
        solver.setup(number(1234.5))
        assert type(solver.tau) is float
        guess = wp.zeros(small_mesh.size, dtype=wp.float32, device="cpu")
        solver.solve(rhs, guess, out, 1e-3)
        found.append(out.numpy())
    assert np.array_equal(*found)


def test_reference_depth_is_that_below_a_level_surface_and_deep_enough(small_mesh) -> None:
    flat = make_scene("advection", "pressure", "rotation")
    assert reference_depth(Model(small_mesh, flat)) == pytest.approx(1000.0)
    hill = lambda lon, lat: (0.0 * lat, 0.0 * lat, 1000.0 + 4000.0 * (lat > 1.0))  # noqa: E731
    assert reference_depth(Model(small_mesh, replace(flat, initial=hill))) == pytest.approx(4000.0)
    mountain = Model(small_mesh, get_scene("williamson5"))
    surface = reference_depth(mountain) + mountain.bottom
    assert np.ptp(mountain.bottom) > 1000.0
    assert surface == pytest.approx(surface.mean(), rel=1e-12)


def test_reference_depth_is_at_most_that_of_the_fluid(small_mesh) -> None:
    """A layer of 10 m over a bottom that falls by 1900 m, balanced by its wind."""
    layer = Model(small_mesh, thin_flow(10.0, 1.0))
    assert np.ptp(layer.bottom) > 1000.0
    assert 8.0 <= reference_depth(layer).min() <= reference_depth(layer).max() <= 10.0


def test_coriolis_force_limits_steps_where_waves_are_slower_than_the_wind(small_mesh) -> None:
    """Implicit waves do not hold inertial oscillations then, which the wind carries along."""
    layer, deep = (Model(small_mesh, scene) for scene in (thin_flow(1.0, 0.0), thin_flow(1e4, 0.0)))
    slow, fast = (
        STEPPERS["semi-implicit"].spectral_radii(model, model.initial_state()).wave
        for model in (layer, deep)
    )
    assert slow - np.abs(layer.coriolis).max() == pytest.approx(fast, rel=0.1)


@pytest.mark.parametrize(
    ("name", "depth", "alpha"),
    [("semi-implicit", 10.0, 1.0), ("semi-implicit", 1.0, 0.0), ("ars343", 200.0, 1.0)],
)
@pytest.mark.thorough
def test_wind_as_fast_as_the_waves_is_stable_over_a_slope(
    name: str, depth: float, alpha: float
) -> None:
    """Before, the automatic step grew errors to 5e-5 in three days or ended the run."""
    scene, damped = thin_flow(depth, alpha), {"edge-penalty.c": 0.01}
    sim = Simulation(scene, ne=4, np=6, stepper=name, effects=damped)
    assert sim.run(days=3)["l2_v"] < 3e-5


@pytest.mark.parametrize(("depth", "ratio"), [(3000.0, 1.0), (600.0, 2.25)])
def test_ars343_takes_shorter_steps_in_winds_near_the_speed_of_waves(depth, ratio) -> None:
    """It amplifies waves that are less than about 2.7 times as fast as the wind."""
    model = Model(Mesh.build(2, 4), thin_flow(depth, 1.0))
    state = model.initial_state()
    radii = [STEPPERS[name].spectral_radii(model, state).wave for name in ("ars343", "ark2")]
    assert radii[0] / radii[1] == pytest.approx(ratio)


def test_what_cannot_be_semi_implicit_is_refused(small_mesh) -> None:
    model = Model(small_mesh, make_scene(*WAVES))
    with pytest.raises(ConfigError, match="tolerance"):
        STEPPERS["ark2"](model, 60.0, tolerance=1.0)
    for scene in (get_scene("williamson1"), make_scene("advection", "rotation")):
        with pytest.raises(ConfigError, match="no gravity waves"):
            STEPPERS["semi-implicit"](Model(small_mesh, scene), 60.0)


# --- methods


@pytest.mark.parametrize("name", RUNGE_KUTTA)
def test_order_conditions_of_both_tableaus_and_between_them(name: str) -> None:
    """Kennedy & Carpenter 2003, section 2: all trees to order 3 with any mixture of the two."""
    cls = STEPPERS[name]
    b = np.array(cls.b)
    tableaus = [tableau(rows, len(b)) for rows in (cls.explicit, cls.implicit)]
    c_e, c_i = (a.sum(axis=1) for a in tableaus)
    assert c_e == pytest.approx(c_i, abs=1e-14)
    assert b.sum() == pytest.approx(1.0, abs=1e-14)
    for c in (c_e, c_i):
        assert b @ c == pytest.approx(1 / 2, abs=1e-14)
    if cls.order < 3:
        return
    for a in tableaus:
        assert b @ a @ c_i == pytest.approx(1 / 6, abs=1e-14)
    assert b @ c_i**2 == pytest.approx(1 / 3, abs=1e-14)


def growth_of(cls, z_implicit: np.ndarray, z_explicit: np.ndarray) -> np.ndarray:
    """Amplification factors for these eigenvalues times dt of both parts."""
    a_e, a_i = (tableau(rows, len(cls.b)) for rows in (cls.explicit, cls.implicit))
    return runge_kutta_factor(np.array(cls.b), (a_e, z_explicit), (a_i, z_implicit))


@pytest.mark.parametrize("name", RUNGE_KUTTA)
def test_implicit_tableau_is_l_stable_with_one_diagonal(name: str) -> None:
    cls = STEPPERS[name]
    assert len({row[-1] for row in cls.implicit}) == 1
    z = np.array([0.1j, 1j, 10j, 1e4j, 1e8j])
    growth = growth_of(cls, z, 0.0 * z)
    assert np.all(growth <= 1.0 + 1e-12) and growth[-1] < 1e-7


@pytest.mark.parametrize(("name", "powers"), [("ark2", 3), ("ars343", 4)])
def test_explicit_part_alone_is_exponential_as_far_as_the_authors_say(
    name: str, powers: int
) -> None:
    """For linear problems ark2 is one order better, and ars343 has the stability of rk4."""
    z = np.array([0.3j, 1.2j, 2.5j, -1.0 + 0.5j])
    series = sum(z**k / math.factorial(k) for k in range(powers + 1))
    growth = growth_of(STEPPERS[name], 0.0 * z, z)
    assert growth == pytest.approx(np.abs(series), rel=1e-9)


@pytest.mark.parametrize(
    ("name", "deviations", "growth"),
    [("ark2", (-0.1, 0.0, 0.05), 0.0), ("ark2", (-0.32,), 0.5), ("ars343", (-0.8, -0.3, 0.1), 0.0)],
)
def test_explicit_waves_of_a_deviating_depth(name: str, deviations, growth: float) -> None:
    """Wind and depth of one wave, L = iω [[0, 1], [1, 0]] and N = iω [[0, 0], [δ, 0]]."""
    cls = STEPPERS[name]
    a_e, a_i = (tableau(rows, len(cls.b)) for rows in (cls.explicit, cls.implicit))
    largest = 0.0
    for delta, z in itertools.product(deviations, np.geomspace(0.01, 300.0, 60)):
        linear = 1j * z * np.array([[0.0, 1.0], [1.0, 0.0]])
        rest = 1j * z * np.array([[0.0, 0.0], [delta, 0.0]])
        whole = np.eye(2 * len(cls.b)) - np.kron(a_i, linear) - np.kron(a_e, rest)
        stages = np.linalg.solve(whole, np.tile(np.eye(2), (len(cls.b), 1)))
        step = np.eye(2) + np.kron(cls.b, linear + rest) @ stages
        largest = max(largest, np.abs(np.linalg.eigvals(step)).max() - 1.0)
    assert largest == pytest.approx(growth, rel=0.1, abs=1e-9)


@pytest.fixture(scope="module")
def moving():
    """The unsteady flow of Läuter, its state, and the state after two hours in tiny steps."""
    model = Model(Mesh.build(2, 4), get_scene("lauter"))
    state = model.initial_state()
    return model, state, advance("rk4", model, state, 40.0, 7200.0).state.numpy()


def orders(moving, name: str, steps, **options) -> list[float]:
    """Orders found from successive halvings of the time step, by the error of the whole state."""
    model, state, reference = moving
    scale = np.repeat(np.abs(reference).reshape(3, -1).max(axis=1), model.mesh.size)
    weight = np.tile(model.mesh.area, 3) / scale**2
    errors = []
    for dt in steps:
        after = advance(name, model, state, dt, 7200.0, tolerance=1e-9, **options).state.numpy()
        errors.append(np.sqrt(np.sum(weight * (after - reference) ** 2)))
    return [float(np.log2(coarse / fine)) for coarse, fine in pairwise(errors)]


STEPS = (400.0, 200.0, 100.0, 50.0)


@pytest.mark.parametrize("name", RUNGE_KUTTA)
def test_order_by_three_halvings(moving, name: str) -> None:
    found = orders(moving, name, STEPS)
    assert found == pytest.approx([STEPPERS[name].order] * 3, abs=0.15)


def test_semi_implicit_without_its_filter_is_of_second_order(moving, monkeypatch) -> None:
    monkeypatch.setattr(Leapfrog, "default_strength", 0.0)
    found = orders(moving, "semi-implicit", STEPS)
    assert found == pytest.approx([2.0] * 3, abs=0.15)


def test_its_filter_leaves_first_order_in_the_limit(moving) -> None:
    """As in leapfrog: the filter damps by a part of ν (2α - 1) (ω Δt)² a step."""
    found = orders(moving, "semi-implicit", (100.0, 50.0, 25.0))
    assert found[-1] == pytest.approx(STEPPERS["semi-implicit"].order_in(moving[0]), abs=0.15)


def test_semi_implicit_solves_its_equation(small_mesh) -> None:
    """(I - dt L) x+ = x- + 2 dt [F(x) - L x] + dt L x-, then Williams' filter, to round-off."""
    model, dt = Model(small_mesh, make_scene(*WAVES, "drag")), 900.0
    stepper = STEPPERS["semi-implicit"](model, dt, tolerance=1e-12)
    stepper.start(model.initial_state())
    for _ in range(3):
        stepper.step()
    memory = stepper.state_dict()
    past, now = memory["previous"], memory["state"]
    upload, linear, rate, loss = model.device_mesh.upload, model.zeros(), model.zeros(), None
    loss = model.zeros()
    model.conservative_tendency(upload(now), 0.0, rate)
    model.dissipative_tendency(upload(past), loss)

    def wave(x: np.ndarray) -> np.ndarray:
        stepper.solver.waves.apply(upload(x), linear)
        return linear.numpy().copy()

    stepper.step()
    # undo the filter: with d = nu/2 (x- - 2x + x+) the two levels are x + a d and x+ - (1 - a) d
    d = (stepper.state_dict()["previous"] - now) / Leapfrog.default_share
    new = stepper.state.numpy() + (1.0 - Leapfrog.default_share) * d
    left = new - dt * wave(new)
    right = past + 2 * dt * (rate.numpy() + loss.numpy() - wave(now)) + dt * wave(past)
    assert relative(left, right, 3) < 1e-8
    assert d == pytest.approx(0.5 * Leapfrog.default_strength * (past - 2 * now + new), abs=1e-8)


# --- properties of runs


@pytest.mark.parametrize("name", IMEX)
def test_mass_is_kept_to_round_off_whatever_the_tolerance(name: str) -> None:
    model = Model(Mesh.build(3, 4), get_scene("williamson5"))
    state = model.initial_state()
    after = advance(name, model, state, 1800.0, 108000.0, tolerance=0.03).state
    before, now = (np.sum(model.mesh.area * model.fields(x)["h"]) for x in (state, after))
    assert abs(now / before - 1.0) < 1e-13


@pytest.mark.parametrize(
    "precision", ["float64", pytest.param("float32", marks=pytest.mark.thorough)]
)
@pytest.mark.parametrize("name", IMEX)
def test_restart_is_exact_to_the_last_bit(name: str, precision: str) -> None:
    """Interrupted at any step, with dissipation and an odd start time."""
    scene = get_scene("williamson5").with_effect(Viscosity(1e5))
    whole = STEPPERS[name](Model(Mesh.build(2, 4), scene, precision=precision), 1200.0)
    whole.start(whole.model.initial_state(), 123.0)
    memories = [whole.state_dict()]
    for _ in range(5):
        whole.step()
        memories.append(whole.state_dict())
    for steps in (0, 1, 3):
        resumed = STEPPERS[name](Model(Mesh.build(2, 4), scene, precision=precision), 1200.0)
        resumed.load_state_dict(memories[steps], steps)
        for _ in range(5 - steps):
            resumed.step()
        assert resumed.time == whole.time
        for key, value in resumed.state_dict().items():
            assert value.tobytes() == memories[-1][key].tobytes(), key


@pytest.fixture(scope="module")
def mountain():
    """Williamson 5 on a coarse mesh, its state, the leapfrog limit and the spectrum left."""
    model = Model(Mesh.build(8, 4), get_scene("williamson5"))
    state = model.initial_state()
    limit = STEPPERS["leapfrog"].stable_dt(SpectralRadii(model.spectral_radii(state).wave))
    return model, state, limit, STEPPERS["semi-implicit"].spectral_radii(model, state)


@pytest.mark.parametrize(("name", "beyond"), [("semi-implicit", 6), ("ark2", 6), ("ars343", 13)])
def test_stable_far_beyond_the_explicit_limit(mountain, name: str, beyond: float) -> None:
    model, state, limit, rest = mountain
    dt = STEPPERS[name].safety * STEPPERS[name].stable_dt(SpectralRadii(rest.wave))
    assert dt > beyond * limit
    fields = model.fields(advance(name, model, state, dt, 86400.0).state)
    assert np.hypot(fields["u"], fields["v"]).max() < 45.0
    assert 3000.0 < fields["h"].min() < fields["h"].max() < 6100.0


@pytest.mark.parametrize(("name", "times"), [("semi-implicit", 1.5), ("ars343", 2.0)])
def test_automatic_steps_are_not_wasteful(mountain, name: str, times: float) -> None:
    """Steps so much longer blow up when the wind over the mountain has grown."""
    model, state, _, rest = mountain
    dt = times * STEPPERS[name].safety * STEPPERS[name].stable_dt(SpectralRadii(rest.wave))
    with pytest.raises(RunFailed, match="smaller --dt"), np.errstate(all="ignore"):
        advance(name, model, state, dt, 6 * 86400.0)


@pytest.mark.parametrize(
    ("name", "days"),
    [("semi-implicit", 30.0), thorough("forward-backward", 60.0), thorough("ars343", 30.0)],
)
def test_automatic_steps_are_shorter_in_long_runs(name: str, days: float) -> None:
    """The wind over the mountain doubles after three weeks, and longer steps become unstable."""
    given = {"ne": 6, "np": 6, "stepper": name, "effects": {"edge-penalty": {"c": "default"}}}
    steps = []
    for length in (20.0, 40.0):
        simulation = Simulation("williamson5", **given, days=length)
        simulation.begin()
        steps.append(simulation.plan.dt)
    assert steps[1] < 1.05 * STEPPERS[name].long_run_factor * steps[0]
    summary = Simulation("williamson5", **given).run(days=days, progress=False)
    assert summary["completed"], summary["reason"]


def test_limit_is_that_of_the_wind_to_come(mountain) -> None:
    model, state, _, rest = mountain
    start = advection_rate(model, state)
    later = advection_rate(model, advance("rk4", model, state, 1200.0, 4 * 86400.0).state)
    assert later > 1.8 * start
    assert rest.wave == pytest.approx(later, rel=0.15)


def test_advection_rate_against_a_sparse_matrix(small_mesh) -> None:
    model = Model(small_mesh, make_scene(*WAVES))
    x = random_state(model)
    u, v, _ = np.split(x, 3)
    flux = sp.vstack([sp.diags(u), sp.diags(v)])
    advection = (sparse.divergence(small_mesh) @ flux).toarray()
    exact = np.abs(np.linalg.eigvals(advection)).max()
    assert advection_rate(model, model.device_mesh.upload(x)) == pytest.approx(exact, rel=0.02)


def test_inertial_waves_limit_steps_where_the_wind_is_slow(small_mesh) -> None:
    model = Model(small_mesh, make_scene(*WAVES))
    state = model.initial_state()
    slowest = INERTIAL * np.abs(model.coriolis).max()
    assert advection_rate(model, state) < 0.1 * slowest
    assert explicit_radii(model, state).wave == pytest.approx(slowest)


@pytest.mark.parametrize("name", IMEX)
def test_automatic_steps_over_a_mountain_in_a_slow_wind(name: str) -> None:
    """Five explicit limits and more: waves over the mountain must be implicit where they are."""
    mesh = Mesh.build(4, 4, stretch=4.0, centre=(270.0, 30.0))
    model, kind = Model(mesh, get_scene("williamson5", speed=2.0)), STEPPERS[name]
    state = model.initial_state()
    dt = kind.safety * kind.stable_dt(kind.spectral_radii(model, state))
    assert dt * model.spectral_radii(state).wave > 10.0
    fields = model.fields(advance(name, model, state, dt, 2.0 * 86400.0).state)
    assert np.hypot(fields["u"], fields["v"]).max() < 10.0


@pytest.mark.parametrize("name", IMEX)
@pytest.mark.thorough
def test_steady_flow_stays_at_large_steps(name: str) -> None:
    """Williamson 2 after a day in steps of half an hour: the error is that of the mesh."""
    model = Model(Mesh.build(4, 6), get_scene("williamson2"))
    state = model.initial_state()
    exact = state.numpy()

    def error(stepper) -> float:
        return relative(stepper.state.numpy()[-model.mesh.size :], exact[-model.mesh.size :])

    explicit = error(advance("rk4", model, state, 300.0, 86400.0))
    assert error(advance(name, model, state, 1800.0, 86400.0)) < 3.0 * explicit + 1e-6


# --- counts


def iterations(model: Model, dt: float, name: str = "semi-implicit", **options) -> float:
    """Krylov iterations a step, over ten steps after the start."""
    stepper = STEPPERS[name](model, dt, **options)
    stepper.start(model.initial_state())
    stepper.step()
    before = stepper.counters["krylov_iterations"]
    for _ in range(10):
        stepper.step()
    return (stepper.counters["krylov_iterations"] - before) / 10


def test_counts_do_not_grow_with_the_mesh() -> None:
    found = [
        iterations(Model(Mesh.build(ne, 4), get_scene("williamson5")), 1200.0, tolerance=1e-6)
        for ne in (4, 8, 16)
    ]
    assert max(found) < 9.0
    assert max(found[1:]) <= 1.3 * min(found[1:])
    assert max(found) <= 1.3 * found[0] + 1.0


def test_same_counts_on_another_planet_of_the_same_physics() -> None:
    """Radius and gravity in other units: length / 1000, time / 60."""
    length, time = 1e-3, 1.0 / 60.0
    scene = get_scene("williamson5")
    ours = scene.planet
    planet = Planet(
        radius=ours.radius * length, gravity=ours.gravity * length / time**2,
        rotation=ours.rotation / time,
    )  # fmt: skip

    def initial(lon, lat):
        u, v, h = scene.initial(lon, lat)
        return u * length / time, v * length / time, h * length

    small = replace(
        scene,
        planet=planet,
        initial=initial,
        bottom=lambda lon, lat: scene.bottom(lon, lat) * length,
        coriolis=lambda lon, lat: scene.coriolis(lon, lat) / time,
    )
    for name in ("semi-implicit", "ars343"):
        counts = [
            iterations(Model(Mesh.build(4, 4, radius=s.planet.radius), s), dt, name)
            for s, dt in ((scene, 1800.0), (small, 1800.0 * time))
        ]
        assert counts[0] == counts[1] > 0


@pytest.mark.parametrize(
    ("scene", "stepper", "dt"),
    [
        ("lake-at-rest", "ark2", 2880.0),
        ("splash", "semi-implicit", 2880.0),
        ("splash", "ark2", 96.0),
    ],
)
def test_the_coarsest_mesh_is_solved_to_rounding_errors(scene, stepper, dt) -> None:
    """Flow at rest, whose waves are solved for to the last digit."""
    summary = Simulation(scene, ne=1, np=4, stepper=stepper, dt=dt, days=0.1).run()
    assert summary.status == "completed", summary.reason


@pytest.mark.parametrize("stepper", ["leapfrog", "semi-implicit"])
def test_both_steppers_have_the_options_of_the_filter(stepper: str) -> None:
    given = {"ne": 2, "np": 4, "dt": 600.0, "days": 0.25, "stepper": stepper}
    plain, weak, off = (
        Simulation("williamson6", options={} if nu is None else {"strength": nu}, **given)
        for nu in (None, 0.1, 0.0)
    )
    for sim in (plain, weak, off):
        sim.run()
    assert np.array_equal(plain.state.h, weak.state.h)
    assert 1e-3 < np.abs(plain.state.h - off.state.h).max() < 10.0
    assert type(off.stepper).order_in(off.model, strength=0.0) == 2
    for option in ({"strength": -1.0}, {"share": -5.0}, {"share": 1e300}):
        with pytest.raises(ConfigError, match="of the filter must be from 0 to 1"):
            Simulation("williamson6", options=option, **given).run()
