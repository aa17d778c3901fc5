"""What solver tolerances are tied to: rates of change of the state, and truncation errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from support import IMPLICIT, advance, make_scene, some

from swe_sphere.equations.model import Model
from swe_sphere.mesh import Mesh
from swe_sphere.planet import HOUR
from swe_sphere.solvers.vector_space import VectorSpace
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.dirk import SDIRK3, TRBDF2
from swe_sphere.steppers.imex_runge_kutta import ARK2, ARS343
from swe_sphere.steppers.leapfrog import SemiImplicit
from swe_sphere.steppers.stage_solver import TimeDerivatives
from swe_sphere.testcases import get_scene

TURN = 1e-4
"""Angular velocity of inertial oscillations [s-1]."""
SOLVER_PARTS = {
    "semi-implicit": 0.035, "ark2": 0.005, "implicit-euler": 0.01, "crank-nicolson": 0.002,
    "implicit-midpoint": 0.003, "bdf2": 0.015, "tr-bdf2": 0.035, "sdirk3": 0.008, "esdirk4": 0.01,
    "gauss-legendre": 0.007, "average-vector-field": 1e-6,
}  # fmt: skip
"""What solves to the default tolerance may add to the error, in parts of it: up to 2.5 times as
much as was measured.  Defaults ten times as large add more, but for ars343."""


# --- rates of change


def polynomial(t: float) -> np.ndarray:
    """Three numbers that move: with t, t² and t³."""
    return np.array([5.0 + 1000.0 * t, 2.0 * t**2, 250.0 * t**3])


def observed(times: list[float]) -> TimeDerivatives:
    """A motion that took note of the steps between these times."""
    space = VectorSpace(np.ones(3))
    motion, states = TimeDerivatives(space), []
    for t in times:
        states.append(space.zeros())
        states[-1].assign(polynomial(t))
    for i, dt in enumerate(np.diff(times)):
        motion.accept(states[i], states[i + 1], float(dt))
    return motion


@pytest.mark.parametrize("times", [[1.0, 1.5, 2.0, 2.5], [1.0, 1.2, 1.3, 2.3], [0.0, 2.0, 2.3]])
def test_rate_and_frequency_are_divided_differences_whatever_the_steps(times) -> None:
    """Slopes between the last three times, and twice the divided difference of second order."""
    a, b, c = times[-3:]
    slopes = [(polynomial(q) - polynomial(p)) / (q - p) for p, q in ((a, b), (b, c))]
    bend = 2.0 * (slopes[1] - slopes[0]) / (c - a)
    motion = observed(times)
    assert motion.rate == pytest.approx(np.linalg.norm(slopes[1]), rel=1e-12)
    first = np.linalg.norm(bend) / np.linalg.norm(slopes[1])
    assert motion.frequencies[0] == pytest.approx(first, rel=1e-12)


def test_second_frequency_is_of_the_change_of_the_curvature() -> None:
    """With equal steps; x'' is that of the middle of the last three times."""
    motion = observed([0.0, 0.01, 0.02, 0.03])
    assert motion.frequencies[1] == pytest.approx(1500.0 / np.hypot(4.0, 1500.0 * 0.02), rel=1e-9)


def test_motion_goes_on_from_what_it_remembers() -> None:
    whole, part = observed([0.0, 0.3, 0.4, 1.0]), observed([0.0, 0.3, 0.4])
    resumed = TimeDerivatives(VectorSpace(np.ones(3)))
    resumed.load_numbers(part.numbers())
    for name, array in resumed.arrays().items():
        wp.copy(array, part.arrays()[name])
    space = VectorSpace(np.ones(3))
    old, new = space.zeros(), space.zeros()
    old.assign(polynomial(0.4))
    new.assign(polynomial(1.0))
    resumed.accept(old, new, 1.0 - 0.4)
    assert resumed.frequencies == pytest.approx(whole.frequencies, rel=1e-12)


# --- truncation errors


def turned(model: Model, angle: float) -> np.ndarray:
    """The state at which winds of 10 m/s have turned by an angle."""
    return np.repeat([10.0 * np.cos(angle), -10.0 * np.sin(angle), 1000.0], model.mesh.size)


@pytest.fixture(scope="module")
def turning() -> Model:
    """A fluid without pressure, of which every part turns with the same angular velocity."""
    scene = replace(make_scene("rotation"), coriolis=lambda lon, lat: TURN + 0.0 * lat)
    return Model(Mesh.build(2, 4), scene)


@pytest.mark.parametrize("name", IMPLICIT)
def test_solver_is_given_a_part_of_what_the_step_is_wrong_by(turning, name: str) -> None:
    """On an oscillation: a step from exact states, solved exactly, against its tolerance."""
    dt, none = 0.1 / TURN, {"preconditioner": "none"}
    start = turning.device_mesh.upload(turned(turning, 0.0))
    memory = advance(name, turning, start, dt, 2.0 * dt, tolerance=0.0, **none).state_dict()
    exact = {"state": turned(turning, 0.2), "previous": turned(turning, 0.1)}
    memory |= {key: value for key, value in exact.items() if key in memory}
    found = []
    for tolerance in (0.0, 0.5):
        found.append(STEPPERS[name](turning, dt, tolerance=tolerance, **none))
        found[-1].load_state_dict(memory, 2)
        found[-1].step()
    after = turned(turning, 0.3)
    error = np.linalg.norm(found[0].state.numpy() - after)
    part = found[1].solver.tolerance * np.linalg.norm(after - turned(turning, 0.2)) / error
    assert 0.35 < part < 0.6


def test_semi_implicit_schemes_have_the_constants_of_their_parts() -> None:
    """Of the implicit ones in Runge-Kutta methods; leapfrog is wrong by (2 dt)^3 x'''/24."""
    assert ARK2.error_constant == pytest.approx(TRBDF2.error_constant, rel=1e-12)
    assert ARS343.error_constant == pytest.approx(SDIRK3.error_constant, rel=1e-12)
    assert SemiImplicit.error_constant == pytest.approx(8.0 / 24.0 / 2.0)


def test_steps_that_do_not_resolve_the_motion_have_no_larger_tolerance() -> None:
    motion = observed([0.0, 0.3, 0.4, 1.0])
    longest = [motion.truncation(0.1, 3, dt) for dt in (1e2, 1e4)]
    assert longest[0] == longest[1] < 0.1
    assert motion.truncation(0.1, 3, 1e-3) < 1e-6 * longest[0]


# --- default tolerances


@pytest.fixture(scope="module")
def mountain():
    """Waves that an hour does not resolve: the model, its start, and the state after six hours."""
    model = Model(Mesh.build(4, 4), get_scene("williamson5"))
    state = model.initial_state()
    return model, state, advance("rk4", model, state, 300.0, 6.0 * HOUR).state.numpy()


@pytest.mark.parametrize("name", some(SOLVER_PARTS))
def test_default_tolerance_leaves_the_error_that_of_the_scheme(mountain, name: str) -> None:
    model, state, converged = mountain
    usual = advance(name, model, state, HOUR, 6.0 * HOUR)
    exact = advance(name, model, state, HOUR, 6.0 * HOUR, tolerance=1e-9)
    norm = [
        usual.space.norm(model.device_mesh.upload(one - other.state.numpy()))
        for one, other in ((usual.state.numpy(), exact), (converged, exact))
    ]
    assert norm[0] < SOLVER_PARTS[name] * norm[1]
