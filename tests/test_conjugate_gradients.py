"""Conjugate gradients against scipy, and where it must stop by itself."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as sla
import warp as wp

from swe_sphere.solvers.krylov import ConjugateGradients, LinearResult, Status
from swe_sphere.solvers.vector_space import DeviceSpace, VectorSpace

N = 400


def operator(apply):
    """A function of numpy vectors as one of Warp vectors."""

    def call(v: wp.array, out: wp.array) -> None:
        np.copyto(out.numpy(), apply(v.numpy()), casting="same_kind")

    return call


def laplacian(shift: float = 0.01) -> sp.csr_array:
    """A positive matrix of condition number about 4/shift, with a rough diagonal."""
    line = sp.diags_array([-1.0, 2.0 + shift, -1.0], offsets=[-1, 0, 1], shape=(N, N))
    rough = sp.diags_array(np.random.default_rng(3).uniform(0.3, 3.0, N))
    return (rough @ line @ rough).tocsr()


def random(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(N)


def solve(
    apply, b, weights=None, guess=None, real=wp.float64, kernels=False, precondition=None, **options
) -> tuple[LinearResult, np.ndarray]:
    """Result and solution."""
    weights = np.ones(N) if weights is None else weights
    space = (DeviceSpace if kernels else VectorSpace)(weights, real=real)
    x = space.zeros() if guess is None else wp.array(guess, dtype=real, device="cpu")
    result = ConjugateGradients(space).solve(
        operator(apply),
        wp.array(b, dtype=real, device="cpu"),
        x,
        None if precondition is None else operator(precondition),
        **options,
    )
    return result, x.numpy().astype(np.float64)


def scipy_iterations(matrix, b, rtol: float, inverse=None) -> tuple[np.ndarray, int]:
    count = []
    made = None if inverse is None else sla.LinearOperator((N, N), matvec=inverse)
    x, failed = sla.cg(matrix, b, rtol=rtol, M=made, callback=lambda x: count.append(1))
    assert not failed
    return x, len(count)


@pytest.mark.parametrize("kernels", [False, True])
@pytest.mark.parametrize("preconditioned", [False, True])
def test_same_answer_as_scipy_within_the_bound_of_chebyshev(preconditioned, kernels) -> None:
    """The energy norm of the error falls at least as the bound says; round-off delays it a bit."""
    matrix, b, rtol = laplacian(), random(), 1e-8
    diagonal = matrix.diagonal()
    inverse = (lambda r: r / diagonal) if preconditioned else None
    x, count = scipy_iterations(matrix, b, rtol, inverse)
    result, ours = solve(
        matrix.__matmul__, b, precondition=inverse, rtol=rtol, max_iterations=2000, kernels=kernels
    )
    assert result.status is Status.CONVERGED and not result.roundoff
    assert result.iterations == pytest.approx(count, rel=0.1)
    assert result.iterations <= most_iterations(matrix, diagonal if preconditioned else None, rtol)
    assert len(result.history) == result.iterations + 1
    assert ours == pytest.approx(x, abs=1e-5 * np.abs(x).max())
    assert np.linalg.norm(b - matrix @ ours) <= 1.01 * rtol * np.linalg.norm(b)


def most_iterations(matrix, diagonal, rtol: float) -> float:
    """The k for which 2 q^k sqrt(cond A) = rtol, q = (sqrt(cond MA) - 1)/(sqrt(cond MA) + 1).

    M is one over the diagonal; sqrt(cond A) bounds residuals by errors in the energy norm.
    """
    scale = np.ones(N) if diagonal is None else 1.0 / np.sqrt(diagonal)
    scaled = scale[:, None] * matrix.toarray() * scale
    root, plain = np.sqrt(np.linalg.cond(scaled)), np.sqrt(np.linalg.cond(matrix.toarray()))
    return float(np.log(2.0 * plain / rtol) / np.log((root + 1.0) / (root - 1.0)))


@pytest.mark.parametrize("preconditioned", [False, True])
def test_every_iterate_is_that_of_scipy(preconditioned) -> None:
    """While there are few of them, before round-off has grown."""
    matrix, b = laplacian(), random()
    diagonal = matrix.diagonal()
    inverse = (lambda r: r / diagonal) if preconditioned else None
    made = sla.LinearOperator((N, N), matvec=inverse) if preconditioned else None
    for count in (1, 2, 3, 10):
        theirs, _ = sla.cg(matrix, b, rtol=0.0, maxiter=count, M=made)
        result, ours = solve(matrix.__matmul__, b, precondition=inverse, max_iterations=count)
        assert (result.status, result.iterations) == (Status.STAGNATED, count)
        assert ours == pytest.approx(theirs, abs=1e-10 * np.abs(theirs).max())


def test_last_step_leaves_the_least_residual() -> None:
    """An iteration ends the solve if another step along its direction reaches the tolerance."""
    matrix, b = laplacian(), random()
    (first, _), size = solve(matrix.__matmul__, b, max_iterations=1), np.linalg.norm(b)
    image = matrix @ b
    least = np.sqrt(1.0 - (b @ image) ** 2 / (b @ b) / (image @ image))
    assert least < 0.98 * first.residual / size
    result, x = solve(matrix.__matmul__, b, rtol=1.001 * least)
    assert (result.status, result.iterations) == (Status.CONVERGED, 1)
    assert np.linalg.norm(b - matrix @ x) == pytest.approx(least * size, rel=1e-10)


def test_symmetric_in_the_inner_product_of_the_weights() -> None:
    """W^-1 K is not a symmetric matrix, but it is symmetric for the weights W."""
    weights, matrix, b = np.random.default_rng(5).uniform(0.1, 10.0, N), laplacian(), random()
    apply = lambda v: (matrix @ v) / weights  # noqa: E731
    result, x = solve(apply, b, weights, rtol=1e-10, max_iterations=2000)
    assert result.converged
    assert np.linalg.norm(matrix @ x - weights * b) < 1e-8 * np.linalg.norm(weights * b)
    wrong, _ = solve(apply, b, rtol=1e-10, max_iterations=result.iterations)
    assert not wrong.converged


def test_preconditioner_that_is_not_quite_symmetric_and_in_float32() -> None:
    """A symmetric Gauss-Seidel sweep and some of a forward one, which is not symmetric."""
    matrix, b = laplacian(), random()
    lower, diagonal = sp.tril(matrix).tocsr(), matrix.diagonal()

    def sweep(r: np.ndarray) -> np.ndarray:
        forward = sla.spsolve_triangular(lower, r)
        back = sla.spsolve_triangular(lower.T.tocsr(), diagonal * forward, lower=False)
        return (back + 0.3 * forward).astype(np.float32)

    result, _ = solve(matrix.__matmul__, b, precondition=sweep, rtol=1e-6, max_iterations=400)
    assert result.converged
    plain, _ = solve(matrix.__matmul__, b, rtol=1e-6, max_iterations=2000)
    assert result.iterations < 0.7 * plain.iterations


def test_a_good_guess_costs_nothing_and_a_zero_right_hand_side_too() -> None:
    matrix, x = laplacian(), random()
    result, same = solve(matrix.__matmul__, matrix @ x, guess=x, rtol=1e-6)
    assert (result.status, result.iterations) == (Status.CONVERGED, 0)
    assert np.array_equal(same, x)
    result, zero = solve(matrix.__matmul__, np.zeros(N), guess=x)
    assert result.converged and not zero.any()


@pytest.mark.parametrize(("real", "size"), [(wp.float64, 1e-13), (wp.float32, 1e-5)])
def test_tolerance_zero_ends_at_round_off(real, size) -> None:
    matrix, b = laplacian(1.0), random()
    result, x = solve(matrix.__matmul__, b, real=real, rtol=0.0, max_iterations=2000)
    assert result.converged and result.roundoff and "round-off" in result.message
    assert np.linalg.norm(b - matrix @ x) < size * np.linalg.norm(b)


@pytest.mark.parametrize("size", [1.0, 1e-15])
def test_tolerance_zero_asks_no_preconditioner_in_float32_for_less_than_it_can_hold(size) -> None:
    """Of a fluid at rest the right-hand side is rounding, and nothing moves to be compared with."""
    matrix, b = laplacian(1.0), size * random()
    diagonal = matrix.diagonal()
    inverse = lambda r: (r / diagonal).astype(np.float32)  # noqa: E731
    result, x = solve(matrix.__matmul__, b, precondition=inverse, rtol=0.0)
    assert result.converged and result.roundoff, result.message
    assert result.iterations < 60
    assert np.linalg.norm(b - matrix @ x) < 1e-13 * np.linalg.norm(b)


def test_out_of_iterations_is_stagnated_with_the_true_residual() -> None:
    matrix, b = laplacian(), random()
    result, x = solve(matrix.__matmul__, b, rtol=1e-8, max_iterations=5)
    assert (result.status, result.iterations) == (Status.STAGNATED, 5)
    assert result.residual == pytest.approx(np.linalg.norm(b - matrix @ x), rel=1e-10)


def test_what_is_not_positive_is_named() -> None:
    matrix, b = laplacian(), random()
    result, _ = solve(lambda v: -(matrix @ v), b)
    assert result.status is Status.DIVERGED and "operator is not positive" in result.message
    result, _ = solve(matrix.__matmul__, b, precondition=lambda r: -r)
    assert result.status is Status.DIVERGED and "preconditioner is not positive" in result.message


def test_preconditioner_that_fails_at_small_residuals_is_left_out() -> None:
    """A preconditioner in float32 sees rounding errors there, as on ne 1 np 4 at rest."""
    matrix, b = laplacian(0.5), random()
    size = np.linalg.norm(b)
    result, x = solve(
        matrix.__matmul__, b, precondition=lambda r: r if np.linalg.norm(r) > 1e-7 * size else -r,
        rtol=1e-12,
    )  # fmt: skip
    assert result.converged, result.message
    assert np.linalg.norm(b - matrix @ x) < 1e-11 * size


def test_not_a_number_never_enters_the_solution() -> None:
    matrix, b = laplacian(), random()
    bad = b.copy()
    bad[7] = np.nan
    for result, x in (
        solve(matrix.__matmul__, bad),
        solve(lambda v: np.full(N, np.nan) if v.any() else v, b),
        solve(matrix.__matmul__, b, precondition=lambda r: r * np.inf),
    ):
        assert result.status is Status.NAN
        assert np.all(np.isfinite(x))


@pytest.mark.parametrize("size", [1e-320, 1e-290, 1e290])
def test_what_overflows_ends(size: float) -> None:
    """A step to what no float holds is not taken, nor is one tried again and again."""
    matrix, calls = size * laplacian(1.0), []
    result, x = solve(
        lambda v: (calls.append(1), matrix @ v)[1], 1e10 * random(), max_iterations=50
    )
    assert result.status is not Status.CONVERGED
    assert len(calls) < 150
    assert np.all(np.isfinite(x))


def test_repeats_to_the_last_bit() -> None:
    matrix, b, space = laplacian(), random(), VectorSpace(np.ones(N))
    solver, found = ConjugateGradients(space), []
    rhs = wp.array(b, dtype=wp.float64, device="cpu")
    for _ in range(2):
        x = space.zeros()
        result = solver.solve(operator(matrix.__matmul__), rhs, x, max_iterations=2000)
        found.append((result.history, x.numpy().tobytes()))
    assert found[0] == found[1]


def test_an_iteration_takes_one_sum_over_all_ranks() -> None:
    """Beside those that begin and end a descent."""
    space, matrix, sums = VectorSpace(np.ones(N)), laplacian(0.5), []
    call = space.projections  # which all other products call
    space.projections = lambda *x: (sums.append(x), call(*x))[1]
    b, x = wp.array(random(), dtype=wp.float64, device="cpu"), space.zeros()
    result = ConjugateGradients(space).solve(operator(matrix.__matmul__), b, x, rtol=1e-8)
    assert result.iterations > 20 and len(sums) <= result.iterations + 3


@pytest.mark.parametrize("limit", [60, 300])
def test_the_limit_of_iterations_is_named_although_the_residual_has_risen(limit: int) -> None:
    matrix = sp.diags_array(np.logspace(0.0, 8.0, 400))
    space = VectorSpace(np.ones(400), real=wp.float64)
    b, x = wp.array(np.ones(400), dtype=wp.float64), space.zeros()

    def apply(v: wp.array, out: wp.array) -> None:
        np.copyto(out.numpy(), matrix @ v.numpy())

    result = ConjugateGradients(space).solve(apply, b, x, None, 1e-10, max_iterations=limit)
    assert result.residual > result.history[0]
    assert result.status is Status.STAGNATED and result.message.startswith("out of iterations")
