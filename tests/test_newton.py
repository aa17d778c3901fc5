"""Newton-Krylov against scipy and theory, and where it must stop by itself."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
import scipy.optimize
import scipy.sparse as sp
import scipy.sparse.linalg as sla
import warp as wp

from swe_sphere.equations.right_hand_side import Operator
from swe_sphere.solvers.krylov import FlexibleGMRES, LinearResult, Status
from swe_sphere.solvers.newton import (
    NewtonKrylov,
    NewtonResult,
    Search,
    backtrack,
    forcing_term,
)
from swe_sphere.solvers.vector_space import DeviceSpace, VectorSpace

Function = Callable[[np.ndarray], np.ndarray]
SIDE = 16


class Equation:
    """A problem given by numpy functions: F(x), J(x) as anything with @, and an inverse of J."""

    def __init__(
        self, f: Function, j: Callable[[np.ndarray], object], near_inverse: Function | None = None
    ) -> None:
        self.f, self.j, self.near_inverse = f, j, near_inverse
        self.calls = {"residual": 0, "linearise": 0, "jacobian": 0}

    def residual(self, x: wp.array, out: wp.array) -> None:
        self.calls["residual"] += 1
        np.copyto(out.numpy(), self.f(x.numpy()))

    def linearise(self, x: wp.array) -> None:
        self.calls["linearise"] += 1
        self.matrix = self.j(x.numpy().copy())

    def jacobian(self, d: wp.array, out: wp.array) -> None:
        self.calls["jacobian"] += 1
        np.copyto(out.numpy(), self.matrix @ d.numpy())

    @property
    def precondition(self) -> Operator | None:
        near = self.near_inverse
        return None if near is None else lambda r, out: np.copyto(out.numpy(), near(r.numpy()))


def laplacian() -> sp.csr_array:
    """Five-point -Laplacian on the unit square, times the square of the spacing."""
    line = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(SIDE, SIDE))
    eye = sp.eye_array(SIDE)
    return (sp.kron(line, eye) + sp.kron(eye, line)).tocsr()


def bratu(preconditioned: bool = True) -> Equation:
    """-Laplacian u = 6 exp(u): the Bratu problem, near its turning point at 6.8."""
    a, c = laplacian(), 6.0 / (SIDE + 1) ** 2
    return Equation(
        lambda u: a @ u - c * np.exp(u),
        lambda u: a - sp.diags_array(c * np.exp(u)),
        sla.splu(a.tocsc()).solve if preconditioned else None,
    )


def one(f: Function, slope: Function) -> Equation:
    """A system of one unknown, or of several that do not know of each other."""
    return Equation(f, lambda x: np.diag(slope(x)))


class Noting(FlexibleGMRES):
    """Solver that notes the tolerance and the number of iterations of each solve."""

    def __init__(self, space: VectorSpace, size: int) -> None:
        super().__init__(space, size)
        self.forcing: list[float] = []
        self.krylov: list[int] = []

    def solve(self, *args: object, **options: object) -> LinearResult:
        result = super().solve(*args, **options)
        self.forcing.append(options["rtol"])
        self.krylov.append(result.iterations)
        return result


@pytest.fixture
def lengths(monkeypatch) -> list[float]:
    """Lengths of the steps of line searches, one after the other."""
    found: list[float] = []

    def noting(*args: object) -> Search:
        search = backtrack(*args)
        found.append(search.length)
        return search

    monkeypatch.setattr("swe_sphere.solvers.newton.backtrack", noting)
    return found


def solve(
    problem: Equation,
    guess: np.ndarray,
    scale: float | None = None,
    rtol: float = 1e-6,
    real: type = wp.float64,
    weights: np.ndarray | None = None,
    size: int = 40,
    kernels: bool = False,
    linear: type | None = None,
    **options: object,
) -> tuple[NewtonResult, np.ndarray]:
    """Result and solution; linear: number type of the linear solves, `real` by default."""
    guess = np.asarray(guess, dtype=np.float64)
    weights = np.ones(guess.size) if weights is None else weights
    kind = DeviceSpace if kernels else VectorSpace
    space = kind(weights, real=real)
    x = wp.array(guess, dtype=real, device="cpu")
    problem.gmres = Noting(kind(weights, real=linear or real), size)
    newton = NewtonKrylov(space, problem.gmres, **options)
    result = newton.solve(problem, x, rtol, scale)
    return result, x.numpy().astype(np.float64)


@pytest.mark.parametrize("kernels", [False, True])
@pytest.mark.parametrize("preconditioned", [False, True])
@pytest.mark.parametrize("linear", [wp.float64, wp.float32])
def test_bratu_against_scipy(linear: type, preconditioned: bool, kernels: bool) -> None:
    problem, zero = bratu(preconditioned), np.zeros(SIDE**2)
    expected = scipy.optimize.newton_krylov(problem.f, zero, f_tol=1e-12)
    result, u = solve(problem, zero, rtol=1e-10, kernels=kernels, linear=linear)
    assert result.status is Status.CONVERGED
    assert u == pytest.approx(expected, abs=1e-8)
    assert result.newton_iterations <= 7
    assert np.linalg.norm(problem.f(u)) <= 1e-10 * np.linalg.norm(problem.f(zero))
    if preconditioned:
        assert result.krylov_iterations < 25


@pytest.mark.parametrize("kernels", [False, True])
def test_linear_systems_in_float32_leave_no_larger_residual(kernels: bool) -> None:
    problem, zero = bratu(), np.zeros(SIDE**2)
    result, u = solve(problem, zero, rtol=0.0, kernels=kernels, linear=wp.float32)
    assert result.converged and result.roundoff
    assert np.linalg.norm(problem.f(u)) <= 1e-14 * np.linalg.norm(u)
    assert min(problem.gmres.forcing) > 1e-5


def test_reaction_diffusion_step_against_scipy() -> None:
    """An implicit Euler step of two species that react, with advection: nonsymmetric."""
    a, n, tau = laplacian(), SIDE**2, 0.8
    wind = sp.diags_array([-0.3, 0.3], offsets=[-1, 1], shape=(n, n))
    old = np.random.default_rng(0).uniform(0.5, 1.5, 2 * n)
    linear = sp.block_diag([a + wind, 0.1 * a])

    def f(z: np.ndarray) -> np.ndarray:
        rate = z[:n] ** 2 * z[n:]
        return z - old + tau * (linear @ z - np.r_[rate, -rate])

    def j(z: np.ndarray) -> sp.csr_array:
        rows = [[2.0 * z[:n] * z[n:], z[:n] ** 2]] * 2
        blocks = [
            [sp.diags_array(sign * d) for d in row] for sign, row in zip((1, -1), rows, strict=True)
        ]
        return sp.eye_array(2 * n) + tau * (linear - sp.block_array(blocks))

    result, z = solve(Equation(f, j), old, rtol=1e-9)
    assert result.converged
    assert z == pytest.approx(scipy.optimize.newton_krylov(f, old, f_tol=1e-11), abs=1e-7)


def constant(eta: float) -> Callable[[float, float, float | None], float]:
    """The same forcing term in every iteration."""
    return lambda *_: eta


def test_history_and_counts_tell_what_was_done() -> None:
    problem = bratu()
    result, u = solve(problem, np.zeros(SIDE**2), rtol=1e-8)
    residuals = result.history
    assert len(residuals) == result.newton_iterations + 1
    assert len(problem.gmres.krylov) == result.newton_iterations
    assert result.krylov_iterations == sum(problem.gmres.krylov) == problem.calls["jacobian"]
    assert problem.calls["linearise"] == result.newton_iterations
    assert all(after < before for before, after in pairwise(residuals))
    assert result.residual == pytest.approx(np.linalg.norm(problem.f(u)), rel=1e-9)
    assert "\n" not in result.message
    assert f"{result.krylov_iterations} Krylov" in result.message


def test_convergence_is_quadratic_when_the_systems_are_solved_well() -> None:
    problem = bratu()
    result, _ = solve(problem, np.zeros(SIDE**2), rtol=1e-9, forcing=constant(1e-11))
    r = np.array(result.history)
    orders = np.log(r[2:] / r[1:-1]) / np.log(r[1:-1] / r[:-2])
    assert orders[-1] == pytest.approx(2.0, abs=0.1)
    loose, _ = solve(problem, np.zeros(SIDE**2), rtol=1e-9, forcing=constant(0.1))
    assert loose.newton_iterations > result.newton_iterations + 1
    assert loose.krylov_iterations < result.krylov_iterations


def test_forcing_terms_spare_krylov_iterations() -> None:
    zero = np.zeros(SIDE**2)
    tight, _ = solve(bratu(False), zero, rtol=1e-9, forcing=constant(1e-9))
    adaptive, _ = solve(bratu(False), zero, rtol=1e-9)
    assert adaptive.converged
    assert adaptive.krylov_iterations < 0.8 * tight.krylov_iterations
    assert adaptive.newton_iterations <= tight.newton_iterations + 2


def test_forcing_terms() -> None:
    choice = forcing_term
    assert choice(1.0, 0.0, None) == 0.02
    assert choice(1.0, 0.08, None) == pytest.approx(0.04)
    # the last step: both parts of what is left, at right angles, make 0.9 of the target or less
    assert choice(1.0, 0.05, 0.0) == pytest.approx(0.045)
    assert choice(2.0, 0.1, 0.015) == pytest.approx(0.9 * 0.04)
    # not the last one: twice what the model will miss, but no more than half of the way or the cap
    assert choice(1.0, 1e-4, 1e-2) == pytest.approx(2e-2)
    assert choice(1.0, 1e-4, 1e-3) == pytest.approx(1e-2)
    assert choice(1.0, 1e-4, 1.0) == 0.1
    assert choice(1.0, 0.4, 1.0) == pytest.approx(0.2)
    assert choice(1.0, 0.0, 0.0) == 1e-6


def test_what_the_linear_model_misses_is_remembered() -> None:
    """z^2 = 2: F(z + d) - F - F' d is d^2, which for F' d = -F is F^2/F'^2."""
    newton = NewtonKrylov(
        VectorSpace(np.ones(1)), FlexibleGMRES(VectorSpace(np.ones(1)), 3), forcing=constant(1e-12)
    )
    assert newton.nonlinearity is None
    x = wp.array([1.42], dtype=wp.float64, device="cpu")
    assert newton.solve(one(lambda z: z**2 - 2.0, lambda z: 2.0 * z), x).converged
    assert newton.nonlinearity == pytest.approx(1.0 / 8.0, rel=1e-3)


def test_a_nearly_linear_problem_is_solved_at_once_after_the_first_time() -> None:
    """The second of two like solves knows what the first has found out, and needs one step."""
    rng = np.random.default_rng(0)
    a, b = 4.0 * np.eye(40) + rng.standard_normal((40, 40)) / 3.0, rng.standard_normal(40)
    problem = Equation(lambda z: a @ z + 1e-6 * z**2 - b, lambda z: a + np.diag(2e-6 * z))
    space = VectorSpace(np.ones(40))
    gmres = Noting(space, 40)
    newton = NewtonKrylov(space, gmres)
    first, second = (newton.solve(problem, space.zeros(), 1e-4) for _ in range(2))
    assert first.converged
    assert second.converged
    assert first.newton_iterations > second.newton_iterations == 1
    assert gmres.forcing[first.newton_iterations] < 1e-4


@pytest.mark.parametrize("guess", [0.0, 3.0])
def test_linear_problem_takes_one_iteration(guess: float) -> None:
    a, b = laplacian() + 2.0 * sp.eye_array(SIDE**2), np.ones(SIDE**2)
    problem = Equation(lambda x: a @ x - b, lambda x: a)
    result, x = solve(problem, np.full(SIDE**2, guess), rtol=1e-8, forcing=constant(1e-9))
    assert (result.status, result.newton_iterations) == (Status.CONVERGED, 1)
    assert problem.calls["residual"] == 2
    assert x == pytest.approx(sla.spsolve(a, b), abs=1e-7)


def test_good_guess_needs_no_iteration() -> None:
    problem = one(lambda x: x - 1.0, np.ones_like)
    result, x = solve(problem, np.ones(3), rtol=0.0)
    assert (result.status, result.newton_iterations) == (Status.CONVERGED, 0)
    assert problem.calls["residual"] == 1
    assert np.array_equal(x, np.ones(3))


def test_tolerance_relative_to_a_scale() -> None:
    problem, zero = bratu(), np.zeros(SIDE**2)
    scale = 1e4 * float(np.linalg.norm(problem.f(zero)))
    plain, _ = solve(problem, zero, rtol=1e-7)
    eased, _ = solve(problem, zero, scale, rtol=1e-7)
    assert eased.converged
    assert eased.newton_iterations < plain.newton_iterations
    assert 1e-9 * scale < eased.residual <= 1e-7 * scale


@pytest.mark.parametrize("rtol", [0.0, 1e-30])
@pytest.mark.parametrize(("real", "reach"), [(wp.float64, 1e-13), (wp.float32, 1e-5)])
def test_tolerance_beyond_roundoff(rtol: float, real: type, reach: float) -> None:
    problem, zero = bratu(), np.zeros(SIDE**2)
    _, expected = solve(problem, zero, rtol=1e-13)
    result, u = solve(problem, zero, real=real, rtol=rtol)
    assert (result.status, result.roundoff) == (Status.CONVERGED, True)
    assert "round-off" in result.message
    assert result.newton_iterations < 12
    assert u == pytest.approx(expected, abs=10.0 * reach)


@pytest.mark.parametrize("start", [3.0, 20.0, -100.0])
def test_line_search_where_the_full_step_diverges(start: float, lengths: list[float]) -> None:
    """arctan(x) = 0 from beyond 1.39: Newton's method alone runs away."""
    problem, guess = one(np.arctan, lambda x: 1.0 / (1.0 + x**2)), np.array([start])
    result, x = solve(problem, guess, rtol=1e-12)
    assert result.converged
    assert x == pytest.approx([0.0], abs=1e-11)
    assert min(lengths) < 0.5 < lengths[-1]


def test_steps_back_from_where_the_residual_is_not_a_number(lengths: list[float]) -> None:
    """log(x) = 0 from 6: the full step leads to a negative x, as one to a negative depth would."""
    problem = one(lambda x: np.log(x), lambda x: 1.0 / x)
    with np.errstate(invalid="ignore"):
        result, x = solve(problem, np.array([6.0, 2.0]), rtol=1e-10)
    assert result.converged
    assert lengths[0] <= 0.25
    assert x == pytest.approx(np.ones(2), abs=1e-9)


def test_stagnation_where_there_is_no_solution() -> None:
    """x^2 + 1 = 0: the search ends at the minimum of |F|, and says so."""
    problem = one(lambda x: x**2 + 1.0, lambda x: 2.0 * x)
    result, x = solve(problem, np.array([0.7]), rtol=1e-8, max_iterations=50)
    assert result.status is Status.STAGNATED
    assert result.residual >= 1.0
    assert np.abs(x[0]) < 0.7
    assert result.residual == pytest.approx(x[0] ** 2 + 1.0)


def test_stagnation_at_a_singular_jacobian() -> None:
    problem = one(lambda x: x**2 - 1.0, lambda x: 2.0 * x)
    result, x = solve(problem, np.zeros(4), rtol=1e-8)
    assert result.status is Status.STAGNATED
    assert "singular" in result.message
    assert not x.any()


def test_out_of_newton_iterations() -> None:
    result, _ = solve(bratu(), np.zeros(SIDE**2), rtol=1e-12, max_iterations=2)
    assert (result.status, result.newton_iterations) == (Status.STAGNATED, 2)
    assert "out of Newton iterations" in result.message


def test_few_krylov_iterations_still_give_a_direction() -> None:
    problem = bratu(False)
    result, _ = solve(problem, np.zeros(SIDE**2), rtol=1e-6, max_krylov=12, max_iterations=40)
    assert result.converged
    assert max(problem.gmres.krylov) == 12


@pytest.mark.parametrize("where", ["residual", "first trial", "jacobian", "guess"])
def test_not_a_number(where: str) -> None:
    problem = bratu()
    f, j, guess = problem.f, problem.j, np.zeros(SIDE**2)
    if where == "guess":
        guess[5] = np.nan
    if where == "residual":
        problem.f = lambda u: np.full_like(u, np.inf)
    if where == "first trial":
        problem.f = lambda u: np.full_like(u, np.nan) if problem.calls["residual"] > 1 else f(u)
    if where == "jacobian":
        problem.j = lambda u: j(u) * np.nan
    result, u = solve(problem, guess, rtol=1e-6)
    assert result.status is Status.NAN
    assert np.array_equal(u, guess, equal_nan=True)
    assert problem.calls["residual"] < 15


def test_counts_do_not_depend_on_units() -> None:
    """Unknowns and equations in other units, node by node, with weights that make up for it."""
    plain_problem, s = bratu(), np.where(np.arange(SIDE**2) % 2 == 0, 1e-3, 3600.0)
    scaled_problem = Equation(
        lambda y: s * plain_problem.f(y / s),
        lambda y: sp.diags_array(s) @ plain_problem.j(y / s) @ sp.diags_array(1.0 / s),
        lambda r: s * plain_problem.near_inverse(r / s),
    )
    plain, u = solve(plain_problem, np.zeros(SIDE**2), rtol=1e-9)
    scaled, y = solve(scaled_problem, np.zeros(SIDE**2), weights=s**-2, rtol=1e-9)
    assert plain_problem.gmres.krylov == scaled_problem.gmres.krylov
    assert scaled.history[:-1] == pytest.approx(plain.history[:-1], rel=1e-6)
    assert y / s == pytest.approx(u, rel=1e-7)
