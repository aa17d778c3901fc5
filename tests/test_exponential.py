"""Exponential steppers: the Krylov solver against dense exponentials, orders, exact cases."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import scipy.linalg as sl
import warp as wp
from support import EXPONENTIAL, advance, make_scene, random_state, relative

from swe_sphere.equations.model import Model
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY, HOUR
from swe_sphere.solvers.krylov import WINDOW, KrylovBasis
from swe_sphere.solvers.vector_space import DeviceSpace, VectorSpace
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.exponential import (
    ExponentialMultistep,
    ExponentialResult,
    KrylovExponential,
    _remainder,
)
from swe_sphere.steppers.stage_solver import energy_weights
from swe_sphere.testcases import get_scene

N, LENGTH = 60, 3.0
KINDS = ("waves", "damped", "damping", "any")


def matrix(kind: str) -> np.ndarray:
    """A matrix (N, N) with eigenvalues imaginary, negative, or any, of modulus up to 3 to 11."""
    rng = np.random.default_rng(5)
    a = rng.standard_normal((N, N))
    skew, square = (a - a.T) / 2.0, -a @ a.T / 20.0
    parts = {"waves": skew, "damped": skew + 0.3 * square, "damping": square, "any": 0.4 * a}
    return parts[kind]


def operator(a: np.ndarray):
    """The matrix as an operator on Warp vectors."""

    def call(v: wp.array, out: wp.array) -> None:
        np.copyto(out.numpy(), a @ v.numpy(), casting="same_kind")

    return call


def dense(a: np.ndarray, u: np.ndarray, length: float) -> np.ndarray:
    """sum_k T^k phi_k(T A) u_k, for u (terms, n), by the exponential of one augmented matrix."""
    n, terms = len(a), len(u)
    augmented = np.zeros((n + terms, n + terms))
    augmented[:n, :n], augmented[:n, n:] = a, u[::-1].T
    augmented[n:, n:] = np.eye(terms, k=1)
    found: np.ndarray = sl.expm(length * augmented)[:n, -1]
    return found


def solve(
    a, terms: int, tolerance: float, size: int = 100, real=wp.float64, kernels=False, length=LENGTH
) -> tuple[ExponentialResult, float, float]:
    """The result for random sources, its error and the size of the solution."""
    rng = np.random.default_rng(terms)
    n = len(a)
    kind = DeviceSpace if kernels else VectorSpace
    space = kind(rng.uniform(0.5, 2.0, n), real=real)
    solver, u = KrylovExponential(space, terms, size), np.zeros((terms, n))
    for k in range(terms):
        dtype = wp.dtype_to_numpy(real)
        moved, plain = (rng.standard_normal(n).astype(dtype) * part for part in (k > 0, 1))
        u[k] = plain + a @ moved.astype(float)
        solver.moved[k].assign(moved)
        solver.plain[k].assign(plain)
    out = space.zeros()
    result = solver.solve(operator(a), terms, length, tolerance, out)
    exact = space.zeros()
    exact.assign(dense(a, u, length))
    scale = space.norm(exact)
    space.axpy(-1.0, out, exact)
    return result, space.norm(exact), scale


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("terms", [1, 2, 3, 4])
def test_all_products_against_dense_exponentials(kind: str, terms: int) -> None:
    """To round-off with a tolerance of 0, and within any other."""
    result, error, scale = solve(matrix(kind), terms, 0.0)
    assert result.fault is None and error < 1e-12 * scale
    for tolerance in (1e-2, 1e-5, 1e-8):
        result, error, scale = solve(matrix(kind), terms, tolerance)
        assert result.fault is None and error <= 2.0 * tolerance


@pytest.mark.parametrize("kind", KINDS[:3])
@pytest.mark.parametrize("size", [8, 20])
def test_small_bases_take_several_steps(kind: str, size: int) -> None:
    result, error, _ = solve(matrix(kind), 3, 1e-6, size)
    assert result.fault is None and result.steps > 1
    assert result.iterations <= size * result.steps and error <= 1e-6


@pytest.mark.parametrize("kernels", [False, True])
def test_float32_and_kernels_of_devices(kernels: bool) -> None:
    result, error, scale = solve(matrix("damped"), 4, 0.0, real=wp.float32, kernels=kernels)
    assert result.fault is None and error < 2e-5 * scale
    result, error, scale = solve(matrix("damped"), 4, 1e-9, kernels=True)
    assert error <= 1e-9


def test_waves_take_little_more_vectors_than_the_angle_they_turn() -> None:
    """And the looks at the error, at a matrix that grows, are few."""
    a = np.kron(np.diag(np.linspace(0.0, 40.0, 100)), [[0.0, 1.0], [-1.0, 0.0]])
    result, error, _ = solve(a, 3, 1e-6, length=1.0)
    assert error < 1e-6 and result.steps == 1
    assert 40 < result.iterations < 70


def test_what_cannot_be_solved_is_said() -> None:
    with np.errstate(over="ignore", invalid="ignore"):
        result, *_ = solve(1e12 * matrix("any"), 2, 1e-6, size=5, length=1.0)
    assert result.fault == "the Krylov process does not converge (5 vectors)"


def test_nothing_moves_nothing(small_mesh) -> None:
    space = VectorSpace(np.ones(N))
    out = space.zeros()
    out.fill_(1.0)
    result = KrylovExponential(space, 3).solve(operator(matrix("waves")), 3, LENGTH, 0.0, out)
    assert (result.iterations, result.steps, result.fault) == (0, 1, None)
    assert not out.numpy().any()


def test_basis_is_orthogonal_in_its_window_and_gives_products_back() -> None:
    a, size = matrix("any"), 12
    weights = np.random.default_rng(0).uniform(0.5, 2.0, N)
    space = VectorSpace(weights)
    basis, apply = KrylovBasis(space, size + 1, short=True), operator(a)
    basis.rows[0].assign(np.arange(1.0, N + 1.0))
    basis.start(space.norm(basis.rows[0]))
    for k in range(size):
        apply(basis.rows[k], basis.rows[k + 1])
        c, length = basis.extend(k + 1)
        v = basis.stack.numpy()
        known = v[k + 1 - len(c) : k + 1]
        np.testing.assert_allclose(a @ v[k], c @ known + length * v[k + 1], atol=1e-12)
        products = v[max(0, k + 1 - WINDOW) : k + 2] @ (weights * v[k + 1])
        np.testing.assert_allclose(products, np.eye(len(products))[-1], atol=1e-13)


def test_products_of_the_model_against_dense_exponentials() -> None:
    """With its tangent at a rough state, on a small mesh, over some turns of the fastest waves."""
    model = Model(Mesh.build(2, 4), get_scene("williamson5"))
    state = model.initial_state()
    jacobian, vector, out = model.jacobian().update(state, 0.0), model.zeros(), model.zeros()
    columns = []
    for unit in np.eye(model.size):
        vector.assign(unit)
        jacobian(vector, out)
        columns.append(out.numpy().copy())
    space = VectorSpace(energy_weights(model))
    solver, u = (
        KrylovExponential(space, 3),
        np.random.default_rng(0).standard_normal((3, model.size)),
    )
    u[1:] /= np.array([[1e4], [1e8]])
    for k in range(3):
        solver.plain[k].assign(u[k])
    result = solver.solve(jacobian, 3, 4.0 * HOUR, 0.0, out)
    assert result.fault is None and result.iterations < 80
    exact = dense(np.array(columns).T, u, 4.0 * HOUR)
    assert relative(out.numpy(), exact, 3) < 1e-11


@pytest.mark.parametrize("name", EXPONENTIAL)
def test_weights_take_in_remainders_up_to_the_order(name: str) -> None:
    cls = STEPPERS[name]
    for power in range(2, cls.order):
        assert abs(_remainder(cls.weights, power)) < 1e-15
    assert cls.error_constant == abs(_remainder(cls.weights, cls.order)) > 1e-3


def test_rows_of_weights_may_become_longer(small_mesh) -> None:
    class Ragged(ExponentialMultistep):
        name, order, weights = "ragged", 2, ((0.1,), (0.1, 0.2, 0.3))

    model = Model(small_mesh, get_scene("williamson5"))
    start = model.initial_state()
    found, expected = (advance(name, model, start, 600.0, 1.5 * HOUR) for name in ("ragged", "rk4"))
    assert relative(found.state.numpy(), expected.state.numpy(), 3) < 1e-3


def orders(model: Model, state, name: str, steps, duration: float) -> list[float]:
    """Orders found from successive steps [s], with default tolerances."""
    reference = advance("rk4", model, state, steps[-1] / 8.0, duration).state.numpy()
    scale = np.repeat(np.abs(reference).reshape(3, -1).max(axis=1), model.mesh.size)
    errors = []
    for dt in steps:
        last = advance(name, model, state, dt, duration)
        errors.append(np.linalg.norm((last.state.numpy() - reference) / scale))
        assert last.counters["rejected_steps"] == 0
    return [float(np.log2(a / b)) for a, b in pairwise(errors)]


@pytest.mark.parametrize("name", EXPONENTIAL)
def test_order_by_three_halvings(name: str) -> None:
    """From the start on: the first steps are as accurate as those that know the past."""
    model = Model(Mesh.build(2, 4), get_scene("lauter"))
    steps = (900.0, 450.0, 225.0, 112.5) if name != "epi5" else (600.0, 300.0, 150.0, 75.0)
    found = orders(model, model.initial_state(), name, steps, 4.0 * HOUR)
    assert found == pytest.approx([STEPPERS[name].order] * 3, abs=0.3 if name == "epi5" else 0.15)


@pytest.mark.parametrize("name", EXPONENTIAL)
def test_forcing_that_changes_in_time_keeps_the_order(name: str) -> None:
    model = Model(Mesh.build(2, 4), make_scene("advection", "pressure", "rotation", "forcing"))
    found = orders(model, model.initial_state(), name, (250.0, 125.0, 62.5), 4000.0)
    assert found == pytest.approx([STEPPERS[name].order] * 2, abs=0.15)


@pytest.mark.parametrize("name", EXPONENTIAL)
def test_wind_that_changes_in_time_keeps_the_order(name: str) -> None:
    model = Model(Mesh.build(2, 4), make_scene("wind"))
    rng = np.random.default_rng(0)
    state = model.device_mesh.upload(1000.0 + 100.0 * rng.standard_normal(model.size))
    reference = advance("rk4", model, state, 0.03125, 4.0).state.numpy()
    errors = [
        np.abs(advance(name, model, state, dt, 4.0).state.numpy() - reference).max()
        for dt in (0.5, 0.25)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(STEPPERS[name].order, abs=0.3)


@pytest.mark.parametrize("name", EXPONENTIAL)
def test_linear_motion_is_exact_at_any_step(name: str) -> None:
    """Linearised dynamics: one step of six hours is the exponential of the operator."""
    effects = ("advection", "pressure", "rotation", "linearised")
    model = Model(Mesh.build(2, 4), make_scene(*effects))
    state = model.device_mesh.upload(1e-2 * random_state(model))
    last = advance(name, model, state, 6.0 * HOUR, 12.0 * HOUR, tolerance=1e-10)
    reference = advance("rk4", model, state, 60.0, 12.0 * HOUR)
    assert relative(last.state.numpy(), reference.state.numpy(), 3) < 1e-6


def test_mass_is_kept_over_many_steps() -> None:
    model = Model(Mesh.build(2, 4), get_scene("williamson5"))
    start = model.fields(model.initial_state())["h"] @ model.mesh.area
    for name in EXPONENTIAL:
        last = advance(name, model, model.initial_state(), HOUR, 4.0 * DAY)
        mass = model.fields(last.state)["h"] @ model.mesh.area
        assert abs(mass / start - 1.0) < 1e-13
