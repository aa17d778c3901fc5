"""Implicit steppers: conservation, exact restart, failing solves, precision."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from unittest.mock import Mock

import numpy as np
import pytest
import warp as wp
from support import EXPONENTIAL, make_scene, random_state, relative, some
from threadpoolctl import threadpool_info, threadpool_limits

from swe_sphere.equations.effects import EFFECTS as ALL_EFFECTS
from swe_sphere.equations.effects import Viscosity
from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError, RunFailed, SolverFailed
from swe_sphere.io.integrals import flow_integrals
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY, HOUR
from swe_sphere.solvers.vector_space import VectorSpace
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.average_vector_field import PoissonTendency
from swe_sphere.testcases import get_scene

SOLVES = {
    "implicit-euler": 1,
    "crank-nicolson": 1,
    "implicit-midpoint": 1,
    "bdf2": 1,
    "tr-bdf2": 2,
    "sdirk3": 3,
    "esdirk4": 5,
    "gauss-legendre": 1,
    "average-vector-field": 1,
}
"""Nonlinear solves a step."""
ALL = (*SOLVES, *EXPONENTIAL)
SHAPES = ("element", "node")


def advance(name: str, model: Model, dt: float, steps: int, state=None, **options):
    """A stepper after some steps of dt [s], from the scene's initial state."""
    stepper = STEPPERS[name](model, dt, **options)
    stepper.start(model.initial_state() if state is None else state)
    for _ in range(steps):
        stepper.step()
    return stepper


def invariants(model: Model, state) -> dict[str, float]:
    u, v, h = (model.fields(state)[name] for name in "uvh")
    return flow_integrals(model.mesh, model.scene.planet, u, v, h, model.bottom)


@pytest.fixture(scope="module")
def mountain() -> Model:
    """Flow over a mountain on a turning planet: 96 elements of np 4."""
    return Model(Mesh.build(4, 4), get_scene("williamson5"))


@pytest.fixture(scope="module")
def small_mountain() -> Model:
    return Model(Mesh.build(2, 4), get_scene("williamson5"))


@pytest.fixture(scope="module")
def after_a_day(mountain):
    """Return a function: relative changes of mass and energy over a day of hours with a scheme."""
    start = invariants(mountain, mountain.initial_state())

    @cache
    def changes(name: str) -> dict[str, float]:
        last = invariants(mountain, advance(name, mountain, HOUR, 24, tolerance=1e-10).state)
        return {key: last[key] / start[key] - 1.0 for key in ("mass", "energy")}

    return changes


@pytest.mark.parametrize("name", SOLVES)
@pytest.mark.thorough
def test_mass_is_kept_to_round_off(after_a_day, name: str) -> None:
    assert abs(after_a_day(name)["mass"]) < 1e-13


@pytest.mark.parametrize("name", ALL)
def test_mass_is_kept_by_inexact_solves(small_mountain, name: str) -> None:
    last = advance(name, small_mountain, HOUR, 12, tolerance=0.1).state
    start = invariants(small_mountain, small_mountain.initial_state())["mass"]
    assert abs(invariants(small_mountain, last)["mass"] / start - 1.0) < 1e-13


def test_energy_is_kept_or_lost_as_the_scheme_promises(after_a_day) -> None:
    for name in ("implicit-midpoint", "gauss-legendre"):
        assert abs(after_a_day(name)["energy"]) < 2e-9
    euler, bdf2, tr_bdf2 = (
        after_a_day(name)["energy"] for name in ("implicit-euler", "bdf2", "tr-bdf2")
    )
    assert -1e-3 < euler < bdf2 < tr_bdf2 < -1e-7


@pytest.mark.parametrize("shape", ["element", pytest.param("node", marks=pytest.mark.thorough)])
def test_average_vector_field_keeps_energy(shape: str) -> None:
    """With mountain and rotation, at a step 5 times what waves allow an explicit scheme."""
    model = Model(Mesh.build(4, 4), get_scene("williamson5"), shape=shape)
    start = invariants(model, model.initial_state())
    last = invariants(
        model, advance("average-vector-field", model, HOUR, 24, tolerance=1e-10).state
    )
    assert abs(last["energy"] / start["energy"] - 1.0) < 1e-13
    assert abs(last["mass"] / start["mass"] - 1.0) < 1e-13


EFFECTS = ("advection", "pressure", "rotation", "orography")


@pytest.mark.parametrize("shape", SHAPES)
def test_skew_form_between_equal_states_is_the_right_hand_side(small_mesh, shape: str) -> None:
    model = Model(small_mesh, make_scene(*EFFECTS), shape=shape)
    state = model.device_mesh.upload(random_state(model))
    plain, skew = model.zeros(), model.zeros()
    model.tendency(state, 0.0, plain)
    PoissonTendency(model)(state, state, 0.0, skew)
    assert relative(skew.numpy(), plain.numpy(), 3) < 1e-12


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("effects", [EFFECTS, EFFECTS[:2]], ids="+".join)
def test_skew_form_does_no_work(small_mesh, shape: str, effects) -> None:
    """Times the average slope of the energy between two rough states it gives zero."""
    model = Model(small_mesh, make_scene(*effects), shape=shape)
    first, last = random_state(model, 1), random_state(model, 2)
    out = model.zeros()
    start, end = (model.device_mesh.upload(state) for state in (first, last))
    PoissonTendency(model)(start, end, 0.0, out)
    # three-point Gauss quadrature is exact for the slope of a cubic
    points, weights = np.polynomial.legendre.leggauss(3)
    along = [first + 0.5 * (1.0 + p) * (last - first) for p in points]
    slope = sum(0.5 * w * energy_slope(model, x) for w, x in zip(weights, along, strict=True))
    work = np.tile(model.mesh.area, 3) * slope * out.numpy()
    assert abs(work.sum()) < 1e-13 * np.abs(work).sum()


def energy_slope(model: Model, state: np.ndarray) -> np.ndarray:
    u, v, h = state.reshape(3, -1)
    head = 0.5 * (u**2 + v**2) + model.scene.planet.gravity * (h + model.bottom)
    return np.concatenate([h * u, h * v, head])


def test_skew_form_needs_the_whole_dynamics(small_mesh) -> None:
    assert PoissonTendency.fits(Model(small_mesh, make_scene("advection", "pressure", "rotation")))
    assert not PoissonTendency.fits(Model(small_mesh, make_scene("pressure", "rotation")))


@pytest.mark.parametrize("name", ["average-vector-field", "implicit-midpoint"])
@pytest.mark.thorough
def test_methods_of_one_mean_agree_where_the_equations_are_linear(small_mesh, name: str) -> None:
    """A viscous fluid without waves: both are Crank-Nicolson."""
    model = Model(small_mesh, make_scene("viscosity").with_effect(Viscosity(1e8)))
    state = model.device_mesh.upload(random_state(model))
    ours = advance(name, model, HOUR, 3, state, tolerance=1e-11).state.numpy()
    theirs = advance("crank-nicolson", model, HOUR, 3, state, tolerance=1e-11).state.numpy()
    assert relative(ours, theirs, 3) < 1e-9
    assert relative(ours, state.numpy(), 3) > 1e-3


@pytest.mark.thorough
def test_average_vector_field_dissipates_as_the_midpoint_rule_does() -> None:
    scene = get_scene("williamson2").with_effect(Viscosity(1e7))
    model = Model(Mesh.build(2, 4), scene)
    pair = [
        advance(name, model, HOUR, 4, tolerance=1e-9).state.numpy()
        for name in ("average-vector-field", "implicit-midpoint")
    ]
    inviscid = advance("implicit-midpoint", Model(model.mesh, get_scene("williamson2")), HOUR, 4)
    assert relative(pair[0], pair[1], 3) < 1e-3
    assert relative(inviscid.state.numpy(), pair[1], 3) > 1e-2


@pytest.mark.parametrize("name", ALL)
@pytest.mark.thorough
def test_restart_is_exact_to_the_last_bit(name: str) -> None:
    """Interrupted at any step, with dissipation, at an odd start time and a depth that changes."""
    scene = get_scene("williamson5").with_effect(Viscosity(1e5))
    whole = STEPPERS[name](Model(Mesh.build(2, 4), scene), 7200.0)
    whole.start(whole.model.initial_state(), 123.0)
    memories = [whole.state_dict()]
    for _ in range(6):
        whole.step()
        memories.append(whole.state_dict())
    for steps in (0, 1, 4):
        resumed = STEPPERS[name](Model(Mesh.build(2, 4), scene), 7200.0)
        resumed.load_state_dict(memories[steps], steps)
        assert resumed.time == 123.0 + 7200.0 * steps
        for _ in range(6 - steps):
            resumed.step()
        for key, value in resumed.state_dict().items():
            assert value.tobytes() == memories[-1][key].tobytes(), key


@pytest.mark.parametrize("name", some(ALL))
def test_step_in_two_halves_is_two_steps_of_half_the_size(
    small_mountain, monkeypatch, name: str
) -> None:
    """A first attempt that is said to fail is taken again in halves, and the run goes on."""
    halves = advance(name, small_mountain, 900.0, 2)
    stepper = STEPPERS[name](small_mountain, 1800.0)
    stepper.start(small_mountain.initial_state())
    verdicts = iter(["not today"])
    monkeypatch.setattr(stepper.solver, "fault", lambda state: next(verdicts, None))
    stepper.step()
    assert stepper.counters["rejected_steps"] == 1
    assert (stepper.steps, stepper.time) == (1, 1800.0)
    assert relative(stepper.state.numpy(), halves.state.numpy(), 3) < 1e-6
    stepper.step()
    assert stepper.counters["rejected_steps"] == 1


@pytest.mark.parametrize("name", ["tr-bdf2", "epi3"])
def test_a_step_given_up_leaves_the_state_of_its_start(
    small_mountain, monkeypatch, name: str
) -> None:
    """Which is the one that belongs to `time`, whatever parts of the step have been taken."""
    stepper = advance(name, small_mountain, 1800.0, 1)
    start, attempt, taken = stepper.state.numpy().copy(), stepper.attempt, []

    def attempted(t, dt):
        fault = "no way" if dt == 1800.0 or t > 2600.0 else attempt(t, dt)
        taken.append(fault is None)
        return fault

    monkeypatch.setattr(stepper, "attempt", attempted)
    with pytest.raises(RunFailed, match="64 parts: no way"):
        stepper.step()
    assert any(taken) and stepper.time == 1800.0
    assert np.array_equal(stepper.state.numpy(), start)


@pytest.mark.parametrize("name", some(SOLVES))
def test_solves_that_cannot_converge_are_taken_in_parts(small_mountain, name: str) -> None:
    """With two Newton iterations allowed, a step of a day fails and its parts do not."""
    stepper = STEPPERS[name](small_mountain, DAY, tolerance=1e-4)
    stepper.start(small_mountain.initial_state())
    stepper.solver.newton.max_iterations = 2
    stepper.step()
    assert 0 < stepper.counters["rejected_steps"] < 20
    assert stepper.time == DAY
    fine = advance(name, small_mountain, HOUR, 24).state
    assert relative(stepper.state.numpy(), fine.numpy(), 3) < 0.5


@pytest.mark.parametrize("name", some(ALL))
def test_hopeless_steps_end_the_run_with_one_line(name: str) -> None:
    """A fluid whose depth is negative somewhere has no gravity waves but an explosion."""
    base = get_scene("williamson2")

    def dry(lon, lat):
        u, v, _ = base.initial(lon, lat)
        return u, v, 100.0 - 150.0 * np.cos(2.0 * lon) * np.cos(lat) ** 2

    mesh = Mesh.build(2, 4)
    stepper = STEPPERS[name](Model(mesh, base), HOUR)
    stepper.start(stepper.model.state_from(*dry(mesh.lon, mesh.lat)))
    with pytest.raises(RunFailed, match=r"64 parts: the depth falls to -\d+.* smaller --dt") as end:
        stepper.step()
    assert "\n" not in str(end.value) and name in str(end.value)
    assert stepper.counters["rejected_steps"] == 7


@pytest.mark.parametrize("name", some(ALL))
def test_starting_again_forgets_the_past(small_mountain, name: str) -> None:
    """Set-ups of a preconditioner too, even when they would still serve."""
    state = small_mountain.initial_state().numpy()
    deeper = state * np.repeat([1.0, 1.0, 1.05], small_mountain.mesh.size)
    used = advance(name, small_mountain, 2.0 * HOUR, 2)
    start = small_mountain.device_mesh.upload(deeper)
    used.start(start)
    for _ in range(2):
        used.step()
    fresh = advance(name, small_mountain, 2.0 * HOUR, 2, start)
    assert used.state.numpy().tobytes() == fresh.state.numpy().tobytes()


@pytest.mark.parametrize(("precision", "most"), [("float64", 1e-9), ("float32", 1e-4)])
def test_jacobian_of_coupled_stages_is_exact(small_mountain, precision, most, monkeypatch) -> None:
    """The residual is quadratic: half a central difference of any width is the derivative."""
    n = small_mountain.size
    if precision == "float64":
        monkeypatch.setattr(Model, "for_solves", property(lambda model: model))
    problem = STEPPERS["gauss-legendre"](small_mountain, HOUR).solver.problem
    problem.tau, problem.rhs = HOUR, small_mountain.initial_state()
    point, ahead = (random_state(small_mountain, seed) for seed in (1, 2))
    pair = np.concatenate([point, ahead])
    direction = np.random.default_rng(3).standard_normal(2 * n)

    def evaluate(function, space: VectorSpace, x: np.ndarray) -> np.ndarray:
        out = space.zeros()
        function(wp.array(x, dtype=space.real, device="cpu"), out)
        return out.numpy()

    problem.linearise(small_mountain.device_mesh.upload(pair))
    product = evaluate(problem.jacobian, problem.linear_space, direction)
    sides = [evaluate(problem.residual, problem.space, pair + s * direction) for s in (1.0, -1.0)]
    assert product.dtype == precision
    assert relative(product, 0.5 * (sides[0] - sides[1]), 6) < most


@pytest.mark.parametrize("name", some(SOLVES))
def test_linear_systems_in_float32_give_the_same_steps(small_mountain, name, monkeypatch) -> None:
    """The default tolerance takes as many Newton iterations, a tight one fewer than twice."""
    for tolerance, share in ((None, 1.0), (1e-10, 1.9)):
        ours = advance(name, small_mountain, HOUR, 4, tolerance=tolerance)
        with monkeypatch.context() as patch:
            patch.setattr(Model, "for_solves", property(lambda model: model))
            exact = advance(name, small_mountain, HOUR, 4, tolerance=tolerance)
        assert ours.solver.problem.linear_space.real is wp.float32
        assert exact.solver.problem.linear_space.real is wp.float64
        iterations = (each.counters["newton_iterations"] for each in (ours, exact))
        assert next(iterations) <= share * next(iterations)
        error = relative(ours.state.numpy(), exact.state.numpy(), 3)
        assert error < (1e-4 if tolerance is None else 1e-10), error


@pytest.mark.parametrize("name", some(ALL))
def test_iterations_are_the_same_on_another_planet(small_mountain, name: str) -> None:
    """Lengths times 0.03, times times 0.7: the same flow, as the solver should see it."""
    length, time = 0.03, 0.7
    speed, scene = length / time, small_mountain.scene
    planet = replace(
        scene.planet,
        radius=length * scene.planet.radius,
        gravity=length / time**2 * scene.planet.gravity,
        rotation=scene.planet.rotation / time,
    )

    def initial(lon, lat):
        u, v, h = scene.initial(lon, lat)
        return speed * u, speed * v, length * h

    other = replace(
        scene,
        planet=planet,
        initial=initial,
        bottom=lambda lon, lat: length * scene.bottom(lon, lat),
        coriolis=lambda lon, lat: scene.coriolis(lon, lat) / time,
    )
    model = Model(Mesh.build(2, 4, radius=planet.radius), other)
    ours, theirs = advance(name, model, time * HOUR, 6), advance(name, small_mountain, HOUR, 6)
    # other steppers have counted evaluations of the shared model too
    own = ours.counters.keys() - {"rhs_evaluations", "tangent_evaluations", "setup_seconds"}
    counts = [{name: each.counters[name] for name in own} for each in (ours, theirs)]
    assert counts[0] == pytest.approx(counts[1], rel=0.1)
    scaled = ours.state.numpy().reshape(3, -1) / [[speed], [speed], [length]]
    assert relative(scaled.ravel(), theirs.state.numpy(), 3) < 1e-5


def test_solves_that_never_converge_end_the_run_with_their_reason(small_mountain) -> None:
    stepper = STEPPERS["tr-bdf2"](small_mountain, 2.0 * DAY, tolerance=1e-8)
    stepper.start(small_mountain.initial_state())
    stepper.solver.newton.max_iterations = 1
    with pytest.raises(RunFailed, match="64 parts: out of Newton iterations"):
        stepper.step()


@pytest.mark.parametrize("name", some(ALL))
def test_all_notice_states_that_are_not_numbers(small_mountain, name: str) -> None:
    state = small_mountain.initial_state().numpy().copy()
    state[3] = np.nan
    stepper = STEPPERS[name](small_mountain, HOUR)
    stepper.start(small_mountain.device_mesh.upload(state))
    with pytest.raises(RunFailed, match=name):
        stepper.step()


@pytest.mark.parametrize("name", some(ALL))
def test_tolerance_zero_solves_to_round_off(small_mountain, name: str) -> None:
    exact, tight = (
        advance(name, small_mountain, HOUR, 3, tolerance=tolerance).state.numpy()
        for tolerance in (0.0, 1e-9)
    )
    loose = advance(name, small_mountain, HOUR, 3, tolerance=1e-2).state.numpy()
    assert relative(tight, exact, 3) < 1e-8 < relative(loose, exact, 3)


def test_tolerances_out_of_range_are_refused(small_mountain) -> None:
    for name in ALL:
        for tolerance in (-1.0, 1.0, np.nan):
            with pytest.raises(ConfigError, match="tolerance"):
                STEPPERS[name](small_mountain, HOUR, tolerance=tolerance)


@pytest.mark.parametrize("name", some(SOLVES))
def test_prescribed_wind_takes_one_newton_iteration_a_solve(name: str) -> None:
    model = Model(Mesh.build(2, 4), get_scene("williamson1"))
    stepper = advance(name, model, HOUR, 5, tolerance=1e-6)
    start_up = SOLVES["tr-bdf2"] - 1 if name == "bdf2" else 0
    assert stepper.counters["newton_iterations"] == 5 * SOLVES[name] + start_up
    reference = advance("rk4", model, 60.0, 5 * 60).state.numpy()
    assert relative(stepper.state.numpy(), reference) < (0.3 if name == "implicit-euler" else 0.05)


@pytest.mark.parametrize("name", ALL)
@pytest.mark.thorough
def test_float32_follows_float64(small_mountain, name: str) -> None:
    single = Model(small_mountain.mesh, small_mountain.scene, precision="float32")
    ours, exact = (advance(name, m, HOUR, 5).state.numpy() for m in (single, small_mountain))
    assert ours.dtype == np.float32
    assert relative(ours.astype(np.float64), exact, 3) < 5e-3


@pytest.mark.parametrize("name", SOLVES)
@pytest.mark.parametrize("preconditioner", ["none", "helmholtz-direct"])
@pytest.mark.thorough
def test_solution_does_not_depend_on_the_preconditioner(
    small_mountain, name: str, preconditioner: str
) -> None:
    pair = [
        advance(name, small_mountain, HOUR, 2, tolerance=1e-9, preconditioner=kind)
        for kind in ("helmholtz", preconditioner)
    ]
    assert relative(*(stepper.state.numpy() for stepper in pair), 3) < 1e-7


@pytest.mark.parametrize("name", ["tr-bdf2", "semi-implicit"])
def test_threads_of_other_work_are_left_alone(small_mountain, name: str) -> None:
    """Also those of a stepper that is still there."""

    def threads() -> list[int]:
        return [library["num_threads"] for library in threadpool_info()]

    with threadpool_limits(2, user_api="blas"):
        before = threads()
        stepper = STEPPERS[name](small_mountain, 600.0)
        stepper.start(small_mountain.initial_state())
        stepper.step()
        assert threads() == before


@pytest.mark.thorough
def test_masses_that_an_effect_does_not_declare_conserved_are_left_alone(monkeypatch) -> None:
    """Restoring them would cancel without a word what a new effect does to them."""
    model = Model(Mesh.build(2, 4), make_scene("advection", "pressure", "rotation", "viscosity"))

    def drift() -> float:
        states = model.initial_state(), advance("bdf2", model, 600.0, 5, tolerance=0.5).state
        before, after = (model.mesh.area @ model.fields(state)["h"] for state in states)
        return abs(after / before - 1.0)

    assert drift() < 1e-15
    monkeypatch.setattr(Viscosity, "conserves", frozenset())
    assert drift() > 1e-13


def test_what_built_in_effects_conserve() -> None:
    """All masses, but for relaxation, which moves depth."""
    declared = {name: set(effect.conserves) for name, effect in ALL_EFFECTS.items()}
    assert declared.pop("relaxation") == {"tracers"}
    assert all(masses == {"mass", "tracers"} for masses in declared.values())


def test_bdf2_and_its_start_share_one_set_up(small_mountain) -> None:
    stepper = STEPPERS["bdf2"](small_mountain, HOUR)
    stepper.start(small_mountain.initial_state())
    for _ in range(2):
        stepper.step()
    assert stepper.counters["setups"] == 1


def test_a_failing_start_of_bdf2_leaves_no_trace(small_mountain, monkeypatch) -> None:
    """And what the solver is told to forget before any step is nothing."""
    stepper = STEPPERS["bdf2"](small_mountain, 900.0)
    stepper.solver.reject()
    stepper.start(small_mountain.initial_state())
    failing = SolverFailed("no")
    monkeypatch.setattr(stepper.solver, "solve", Mock(side_effect=failing))
    with pytest.raises(SolverFailed):
        stepper.step()
    assert stepper.solver.prepared_for is None


@pytest.mark.parametrize(
    ("name", "other"), [("bdf2", "leapfrog"), ("semi-implicit", "leapfrog"), ("tr-bdf2", "ark2"),
                        ("epi2", "tr-bdf2")],
)  # fmt: skip
def test_data_of_another_stepper_are_refused(small_mountain, name: str, other: str) -> None:
    data = advance(other, small_mountain, 60.0, 1).state_dict()
    with pytest.raises(ConfigError, match=f"the restart data do not fit stepper {name}: "):
        STEPPERS[name](small_mountain, 60.0).load_state_dict(data, 1)
