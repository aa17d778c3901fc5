"""Flexible GMRES against scipy, and where it must stop by itself."""

from collections.abc import Callable

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as sla
import warp as wp

from swe_sphere.equations.right_hand_side import Operator
from swe_sphere.errors import ConfigError
from swe_sphere.solvers.krylov import FlexibleGMRES, LinearResult, Status
from swe_sphere.solvers.vector_space import DeviceSpace, VectorSpace

Matrix = Callable[[np.ndarray], np.ndarray]


def operator(apply: Matrix) -> Operator:
    """A function of numpy vectors as one of Warp vectors."""

    def call(v: wp.array, out: wp.array) -> None:
        np.copyto(out.numpy(), apply(v.numpy()))

    return call


def advection_diffusion(n: int = 400, wind: float = 0.4) -> sp.csr_array:
    """A nonsymmetric matrix, well enough conditioned to converge in tens of iterations."""
    diagonals = [-1.0 - wind, 2.3, -1.0 + wind]
    return sp.diags_array(diagonals, offsets=[-1, 0, 1], shape=(n, n)).tocsr()


def solve(
    matrix: Matrix,
    b: np.ndarray,
    size: int = 40,
    weights: np.ndarray | None = None,
    guess: np.ndarray | None = None,
    real: type = wp.float64,
    kernels: bool = False,
    precondition: Matrix | None = None,
    **options: float,
) -> tuple[LinearResult, np.ndarray]:
    """Result and solution."""
    weights = np.ones(b.size) if weights is None else weights
    space = (DeviceSpace if kernels else VectorSpace)(weights, real=real)
    x = space.empty_stack(1)[0] if guess is None else wp.array(guess, dtype=real, device="cpu")
    result = FlexibleGMRES(space, size).solve(
        operator(matrix),
        wp.array(b, dtype=real, device="cpu"),
        x,
        None if precondition is None else operator(precondition),
        guess=guess is not None,
        **options,
    )
    return result, x.numpy().astype(np.float64)


def scipy_solve(matrix: Matrix, b: np.ndarray, size: int, rtol: float) -> tuple[np.ndarray, int]:
    """Solution and number of iterations of scipy's GMRES."""
    norms: list[float] = []
    linear = sla.LinearOperator((b.size, b.size), matvec=matrix, dtype=np.float64)
    x, info = sla.gmres(
        linear, b, rtol=rtol, restart=size, callback=norms.append, callback_type="pr_norm"
    )
    assert info == 0
    return x, len(norms)


@pytest.fixture
def b() -> np.ndarray:
    return np.random.default_rng(0).standard_normal(400)


@pytest.mark.parametrize("kernels", [False, True])
@pytest.mark.parametrize(
    ("wind", "size", "rtol"), [(0.4, 60, 1e-8), (0.1, 80, 1e-4), (0.9, 12, 1e-6)]
)
def test_same_counts_and_solution_as_scipy(
    b: np.ndarray, wind: float, size: int, rtol: float, kernels: bool
) -> None:
    a = advection_diffusion(wind=wind)
    expected, count = scipy_solve(a.dot, b, size, rtol)
    result, x = solve(a.dot, b, size, kernels=kernels, rtol=rtol)
    assert result.status is Status.CONVERGED
    assert result.iterations == count
    assert len(result.history) == count + 1
    assert x == pytest.approx(expected, abs=1e-9)
    assert np.linalg.norm(b - a @ x) == pytest.approx(result.residual, rel=1e-5)


def test_restart_when_the_basis_is_full(b: np.ndarray) -> None:
    a = advection_diffusion()
    long, _ = solve(a.dot, b, 100, rtol=1e-8)
    short, x = solve(a.dot, b, 7, rtol=1e-8)
    assert short.converged
    assert short.iterations > long.iterations > 7
    assert np.linalg.norm(b - a @ x) <= 1e-8 * np.linalg.norm(b)


def test_counts_with_a_preconditioner_on_the_right(b: np.ndarray) -> None:
    """scipy preconditions from the left: it is given A M, and its solution is mapped by M."""
    a = advection_diffusion()
    m = sla.spilu(a.tocsc(), drop_tol=0.2, fill_factor=1.0).solve
    expected, count = scipy_solve(lambda v: a @ m(v), b, 40, 1e-9)
    result, x = solve(a.dot, b, precondition=m, rtol=1e-9)
    assert result.iterations == count < solve(a.dot, b, rtol=1e-9)[0].iterations
    assert x == pytest.approx(m(expected), abs=1e-7)


def test_preconditioner_may_vary(b: np.ndarray) -> None:
    """Alternating between two preconditioners; a GMRES for fixed ones would miss the solution."""
    a, calls = advection_diffusion(), [0]
    lower, upper = sp.tril(a).tocsr(), sp.triu(a).tocsr()

    def alternate(r: np.ndarray) -> np.ndarray:
        calls[0] += 1
        odd = bool(calls[0] % 2)
        return sla.spsolve_triangular(lower if odd else upper, r, lower=odd)

    result, x = solve(a.dot, b, precondition=alternate, rtol=1e-9)
    assert result.converged
    assert calls[0] == result.iterations < solve(a.dot, b, rtol=1e-9)[0].iterations
    assert np.linalg.norm(b - a @ x) == pytest.approx(result.residual, rel=1e-4)


def test_exact_preconditioner_takes_one_iteration(b: np.ndarray) -> None:
    a = advection_diffusion()
    result, x = solve(a.dot, b, precondition=sla.splu(a.tocsc()).solve, rtol=1e-10)
    assert (result.status, result.iterations) == (Status.CONVERGED, 1)
    assert a @ x == pytest.approx(b, abs=1e-10)


def test_first_guess_saves_iterations_and_none_takes_no_product(b: np.ndarray) -> None:
    a, calls = advection_diffusion(), [0]

    def counted(v: np.ndarray) -> np.ndarray:
        calls[0] += 1
        return a @ v

    cold, x = solve(counted, b, 60, rtol=1e-6)
    assert calls[0] == cold.iterations
    warm, _ = solve(counted, b, 60, rtol=1e-6, guess=x + 1e-4)
    assert 0 < warm.iterations < cold.iterations
    assert warm.history[0] < 1e-2 * cold.history[0]
    done, same = solve(counted, b, rtol=1e-5, guess=x)
    assert (done.status, done.iterations) == (Status.CONVERGED, 0)
    assert np.array_equal(same, x)


def test_zero_right_hand_side() -> None:
    a = advection_diffusion()
    for rtol in (1e-6, 0.0):
        result, x = solve(a.dot, np.zeros(400), guess=np.ones(400), rtol=rtol)
        assert (result.status, result.iterations, result.residual) == (Status.CONVERGED, 0, 0.0)
        assert not x.any()


@pytest.mark.parametrize("rtol", [0.0, 1e-18])
@pytest.mark.parametrize(("real", "reach"), [(wp.float64, 3e-15), (wp.float32, 2e-6)])
@pytest.mark.parametrize("kernels", [False, True])
def test_tolerance_beyond_roundoff(
    b: np.ndarray, rtol: float, real: type, reach: float, kernels: bool
) -> None:
    a = advection_diffusion()
    b = b.astype(np.float32).astype(np.float64)
    result, x = solve(a.dot, b, real=real, kernels=kernels, rtol=rtol, max_iterations=1000)
    assert (result.status, result.roundoff) == (Status.CONVERGED, True)
    assert "round-off" in result.message
    assert result.iterations < 300
    assert np.linalg.norm(b - a @ x) < reach * np.linalg.norm(b)


@pytest.mark.parametrize("rtol", [1e-6, 1e-9, 1e-13])
def test_reported_residual_is_true_when_ill_conditioned(rtol: float) -> None:
    """Condition 1e8: the residual of the Arnoldi process alone falls far below the true one."""
    n = 60
    turn = np.linalg.qr(np.random.default_rng(3).standard_normal((n, n)))[0]
    a = turn @ np.diag(np.logspace(-8, 0, n)) @ turn.T
    b = np.random.default_rng(4).standard_normal(n)
    result, x = solve(a.dot, b, n, rtol=rtol, max_iterations=2000)
    true = float(np.linalg.norm(b - a @ x))
    assert result.residual == pytest.approx(true, rel=0.5)
    assert result.converged == (result.roundoff or true <= rtol * np.linalg.norm(b))


@pytest.mark.parametrize("real", [wp.float64, wp.float32])
def test_what_cannot_be_solved_is_not_called_converged(real: type) -> None:
    """A matrix so far from normal that round-off in the solution is of the size of the residual."""
    n = 60
    turn = np.linalg.qr(np.random.default_rng(3).standard_normal((n, n)))[0]
    a = turn @ (np.diag(np.logspace(-8, 0, n)) + np.diag(np.full(n - 1, 1e-3), 1)) @ turn.T
    b = np.random.default_rng(4).standard_normal(n)
    result, x = solve(a.dot, b, n, real=real, rtol=1e-6, max_iterations=2000)
    assert result.status is Status.STAGNATED
    assert 1e-3 * np.linalg.norm(b) < result.residual < np.linalg.norm(b)
    assert np.linalg.norm(b - a @ x) == pytest.approx(result.residual, rel=0.2)


@pytest.mark.parametrize("rtol", [1e-6, 1e-9, 1e-11])
def test_reported_residual_is_true_when_convergence_is_fast(rtol: float) -> None:
    """Much of each product lies in the basis already: orthogonality is lost unless looked after."""
    a, b = advection_diffusion() + 3.0 * sp.eye_array(400), np.ones(400)
    result, x = solve(a.dot, b, rtol=rtol)
    assert np.linalg.norm(b - a @ x) == pytest.approx(result.residual, rel=1e-3)


def test_happy_breakdown() -> None:
    """Three eigenvalues: the Krylov space is complete, and the solution exact, after three."""
    a = np.repeat([1.0, 2.0, 5.0], 20)
    b = np.ones(60)
    for rtol in (1e-6, 0.0):
        result, x = solve(lambda v: a * v, b, rtol=rtol)
        assert (result.status, result.iterations) == (Status.CONVERGED, 3)
        assert x == pytest.approx(b / a, rel=1e-13)


def test_singular_operators() -> None:
    """Solved where a solution exists, reported where none does; nothing blows up."""
    a, b = np.r_[np.linspace(1.0, 2.0, 30), 0.0], np.ones(31)
    result, x = solve(lambda v: a * v, b, rtol=1e-6)
    assert result.status is Status.STAGNATED
    assert np.isfinite(x).all()
    assert result.residual == pytest.approx(1.0, rel=1e-6)
    assert x[:-1] == pytest.approx(1.0 / a[:-1], abs=1e-4)
    b[-1] = 0.0
    result, x = solve(lambda v: a * v, b, rtol=1e-10)
    assert result.converged
    assert x[:-1] == pytest.approx(b[:-1] / a[:-1], rel=1e-8)
    result, x = solve(lambda v: 0.0 * v, b, rtol=1e-10)
    assert (result.status, result.iterations) == (Status.STAGNATED, 1)
    assert "singular" in result.message
    assert not x.any()


def test_stagnation_of_short_restarts() -> None:
    """The cyclic shift: no progress at all before the last of n iterations."""
    b = np.zeros(20)
    b[0] = 1.0
    result, x = solve(lambda v: np.roll(v, 1), b, 5, rtol=1e-3, max_iterations=1000)
    assert (result.status, result.iterations) == (Status.STAGNATED, 5)
    assert not x.any()
    result, _ = solve(lambda v: np.roll(v, 1), b, 20, rtol=1e-3)
    assert (result.status, result.iterations) == (Status.CONVERGED, 20)


def test_out_of_iterations(b: np.ndarray) -> None:
    a = advection_diffusion()
    for limit in (4, 15):
        result, x = solve(a.dot, b, 10, rtol=1e-12, max_iterations=limit)
        assert (result.status, result.iterations) == (Status.STAGNATED, limit)
        assert "out of iterations" in result.message
        assert result.residual < 0.5 * np.linalg.norm(b)
        assert np.linalg.norm(b - a @ x) == pytest.approx(result.residual, rel=1e-12)


def test_divergence_of_what_is_not_linear() -> None:
    b = np.random.default_rng(0).standard_normal(50)
    result, _ = solve(lambda v: v + 40.0 * np.abs(v) ** 3, b, 3, rtol=1e-6)
    assert result.status is Status.DIVERGED


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_not_a_number(b: np.ndarray, bad: float) -> None:
    a, calls = advection_diffusion(), [0]

    def fails(v: np.ndarray) -> np.ndarray:
        calls[0] += 1
        return np.full_like(v, bad) if calls[0] == 9 else a @ v

    result, x = solve(fails, b, 5, rtol=1e-12)
    assert result.status is Status.NAN
    assert calls[0] == 9
    # the first cycle of five was good, and is kept
    assert np.linalg.norm(b - a @ x) < 0.5 * np.linalg.norm(b)
    b[3] = bad
    assert solve(a.dot, b)[0].status is Status.NAN
    b[3] = 0.0
    assert solve(a.dot, b, guess=np.full(400, bad))[0].status is Status.NAN
    result, x = solve(a.dot, b, precondition=lambda r: np.full_like(r, bad))
    assert result.status is Status.NAN
    assert not x.any()


def test_units_do_not_matter_when_the_weights_follow(b: np.ndarray) -> None:
    """Metres to kilometres in half the unknowns, hours to seconds in the others."""
    a, s = advection_diffusion(), np.where(np.arange(400) % 3 == 0, 1e-3, 3600.0)
    plain, x = solve(a.dot, b, 20, rtol=1e-7)
    scaled, y = solve(lambda v: s * (a @ (v / s)), s * b, 20, weights=s**-2, rtol=1e-7)
    assert plain.iterations == scaled.iterations
    assert scaled.history == pytest.approx(plain.history, rel=1e-8)
    assert y == pytest.approx(s * x, rel=1e-6)
    careless, _ = solve(lambda v: s * (a @ (v / s)), s * b, 20, rtol=1e-2)
    assert careless.iterations != solve(a.dot, b, 20, rtol=1e-2)[0].iterations


def test_a_solver_is_used_again_without_memory_of_the_last(b: np.ndarray) -> None:
    a = operator(advection_diffusion().dot)
    space = VectorSpace(np.ones(400))
    solver = FlexibleGMRES(space, 10)
    found = []
    for precondition in (None, operator(lambda r: r / 2.3), None):
        x = space.zeros()
        solver.solve(a, wp.array(b, device="cpu"), x, precondition, rtol=1e-6)
        found.append(x.numpy().copy())
    assert found[0].tobytes() == found[2].tobytes()
    assert found[1] == pytest.approx(found[0], abs=1e-3)


def test_no_room_for_a_basis() -> None:
    with pytest.raises(ConfigError, match="at least one"):
        FlexibleGMRES(VectorSpace(np.ones(3)), 0)


def reductions(space: VectorSpace, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The calls, from now on, that several ranks would exchange a message for."""
    made: list[str] = []
    call = space.projections  # which all other products call
    monkeypatch.setattr(space, "projections", lambda *x: (made.append("sum"), call(*x))[1])
    return made


@pytest.mark.parametrize(("shift", "passes"), [(8.0, 1), (0.0, 2)])
def test_an_iteration_takes_one_sum_over_all_ranks(
    b: np.ndarray, shift: float, passes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Or two, where orthogonality would be lost; beside those that begin and end a cycle."""
    matrix = advection_diffusion() + shift * sp.eye_array(b.size)
    space = VectorSpace(np.ones(b.size))
    sums = reductions(space, monkeypatch)
    right, x = wp.array(b, dtype=wp.float64, device="cpu"), space.zeros()
    result = FlexibleGMRES(space, 100).solve(operator(matrix.__matmul__), right, x, rtol=1e-4)
    assert result.iterations > 4 and len(sums) <= passes * result.iterations + 3
