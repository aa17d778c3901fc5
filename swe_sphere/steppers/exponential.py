"""Exponential multistep methods: the linear part is exact, previous steps give the remainder."""

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy
import warp as wp
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.equations.model import Model
from swe_sphere.equations.right_hand_side import Operator
from swe_sphere.errors import ConfigError
from swe_sphere.ranks.limits import check_stop
from swe_sphere.solvers.krylov import KrylovBasis
from swe_sphere.solvers.vector_space import VectorSpace
from swe_sphere.steppers.implicit import VariableStepper
from swe_sphere.steppers.stability import ROUNDING
from swe_sphere.steppers.stage_solver import StageSolver
from swe_sphere.steppers.stepper import read_methods


class SmallMatrix:
    """H (m + 1, m) with A V_m = V_(m+1) H, which grows by a column at a time, up to `size`."""

    def __init__(self, size: int) -> None:
        self._entries = np.zeros((size + 1, size))
        self.columns = 0

    def append(self, above: Array, below: float) -> None:
        """Add a column: `above` ends on the diagonal, entries before it are 0; then `below`."""
        j = self.columns
        self._entries[j + 1 - len(above) : j + 1, j] = above
        self._entries[j + 1, j] = below
        self.columns = j + 1

    def phi(self, order: int, t: float) -> tuple[Array, float]:
        """Return coefficients (m + 1,) of t^order phi_order(t A) v_0, and an estimate of the error.

        phi_k and phi_(k+1) of t H come from one exponential (Sidje 1998, Expokit): the last entry
        of the latter, times the last entry of H, estimates the error of the basis of m vectors, and
        serves here as the coefficient of one more vector.
        """
        m = self.columns
        matrix = np.zeros((m + order + 1, m + order + 1))
        matrix[:m, :m] = t * self._entries[:m, :m]
        matrix[0, m] = 1.0
        matrix[range(m, m + order), range(m + 1, m + order + 1)] = 1.0
        with np.errstate(over="ignore", invalid="ignore"):
            found = scipy.linalg.expm(matrix)
        last = t * self._entries[m, m - 1] * found[m - 1, m + order]
        return t**order * np.append(found[:m, m + order - 1], last), t**order * abs(float(last))

    def radius(self) -> float:
        """Return an estimate of the spectral radius of the skew part of A, for a short basis."""
        m = self.columns
        couplings = np.diag(self._entries, -1)[: m - 1] - np.diag(self._entries, 1)[: m - 1]
        return float(couplings.mean()) if m > 1 else 0.0


SIZE = 100
"""Largest number of vectors of a basis: functions of a larger matrix cost more than they save."""
FIRST_CHECK = 5
"""Number of vectors with which the error is estimated first."""
GROWTH_PARTS = 16
"""The error is estimated again when the basis has grown by 2 and its size over this number."""
SHORTER = 0.85
"""Factor that shortens a time which the largest basis does not reach."""
SHORTEST_SUBSTEP = 1e-4
"""Fraction of the whole time below which a step counts as a failure."""


@dataclass
class ExponentialResult:
    """A solve, in progress or finished, to `length` [s] with an error of at most `tolerance`.

    iterations: Krylov vectors; steps: steps taken; done: time reached [s]; fault: why it failed.
    """

    operator: Operator
    terms: int
    length: float
    tolerance: float
    done: float = 0.0
    iterations: int = 0
    steps: int = 0
    fault: str | None = None


class KrylovExponential:
    """Solver with `size` basis vectors and `terms` sources; an instance allocates only once.

    The sources are u_k = A d_k + e_k, k = 1 ... `terms`: d_k in moved[k - 1], e_k in plain[k - 1].
    Their products with A add no cost to a solve. d_1 must stay 0.
    """

    def __init__(self, space: VectorSpace, terms: int, size: int = SIZE) -> None:
        self.space, self.size = space, size
        stacks = space.stack(terms), space.stack(terms)
        self.moved, self.plain = ([stack[k] for k in range(terms)] for stack in stacks)
        self._moved_from, self._plain_from = ([x[k:] for k in range(terms)] for x in stacks)
        self._basis = KrylovBasis(space, size + 1, short=True)
        self._derivatives = space.stack(max(1, terms - 1))
        self._work = space.zeros()

    def solve(
        self, operator: Operator, terms: int, length: float, tolerance: float, out: wp.array
    ) -> ExponentialResult:
        """Set out = sum_(k <= terms) T^k phi_k(T A) u_k for T = length, to a tolerance.

        tolerance: largest norm of the error of out. If it is below the accuracy of the arithmetic,
        an error of round-off size meets it. After a fault `out` is meaningless.
        """
        p = ExponentialResult(operator, terms, length, tolerance)
        self.space.clear(out)
        while p.done < length:
            size = self._differentiate(p, out)
            if not math.isfinite(size):
                p.fault = "the slopes are not finite"
                break
            t, coefficients = self._reach(p, size, length - p.done)
            if t == 0.0:
                p.fault = f"the Krylov process does not converge ({p.iterations} vectors)"
                break
            powers = [t**j / math.factorial(j) for j in range(1, terms)]
            self.space.combine(out, self._derivatives, powers, out)
            self.space.combine(out, self._basis.stack, coefficients, out)
            p.done = length if t == length - p.done else p.done + t
            p.steps += 1
        return p

    def _differentiate(self, p: ExponentialResult, w: wp.array) -> float:
        """Compute the first derivatives of w at the present time; the last starts the basis."""
        space, last = self.space, w
        for j in range(p.terms):
            powers = [p.done**k / math.factorial(k) for k in range(p.terms - j)]
            target = self._basis.rows[0] if j + 1 == p.terms else self._derivatives[j]
            if j == 0 and p.done == 0.0:
                space.copy(self.plain[0], target)
            else:
                space.combine(last, self._moved_from[j], powers, self._work)
                p.operator(self._work, target)
                space.combine(target, self._plain_from[j], powers, target)
            last = target
        return space.norm(last)

    def _reach(self, p: ExponentialResult, size: float, rest: float) -> tuple[float, Array]:
        """Return the time that a basis reaches, 0 if none, and its vectors' coefficients."""
        nothing = np.zeros(0)
        if size == 0.0:
            return rest, nothing
        self._basis.start(size)
        small, check, rows = SmallMatrix(self.size), FIRST_CHECK, self._basis.rows
        for k in range(self.size):
            check_stop()
            p.operator(rows[k], rows[k + 1])
            p.iterations += 1
            above, below = self._basis.extend(k + 1)
            if not math.isfinite(below):
                return 0.0, nothing
            small.append(above, below)
            if k + 1 >= min(check, self.size) or below == 0.0:
                coefficients, error = small.phi(p.terms, rest)
                if self._is_small(p, error, rest, size):
                    return rest, size * coefficients
                # waves need at least as many vectors as the phase [rad] of the fastest
                least = small.columns + 2 + small.columns // GROWTH_PARTS
                check = max(least, math.ceil(rest * small.radius()))
        t = SHORTER * min(rest, self.size / max(small.radius(), self.size / rest))
        while t > SHORTEST_SUBSTEP * p.length:
            coefficients, error = small.phi(p.terms, t)
            if self._is_small(p, error, t, size):
                return t, size * coefficients
            t *= SHORTER
        return 0.0, nothing

    def _is_small(self, p: ExponentialResult, error: float, t: float, size: float) -> bool:
        """Return whether an error after t is small enough, relative to the first vector."""
        least = self.space.epsilon * t**p.terms / math.factorial(p.terms)
        return error <= max(p.tolerance * t / p.length / size, least)


STAGE = 0.75
"""Time of the second stage of the one-step method, in time steps."""
DRIFT = np.array([-25 / 12, 4.0, -3.0, 4 / 3, -1 / 4])
"""Weights of values at quarters of a step in the derivative at its beginning, of fourth order."""


class ExponentialMultistep(VariableStepper):
    """An exponential propagation iterative (EPI) method of several steps, defined by its weights.

    x+ = x + dt phi_1 F + dt sum_k phi_k sum_i w_ki R_i, R_i = F(x_i) - F(x) - J (x_i - x) of i
    steps before, phi_k = phi_k(dt J) with J at x (Tokman 2006). Explicit dependence on time is a
    further variable: R_i contains - dF/dt (t_i - t), and dt^2 phi_2 dF/dt is added. Until enough
    steps of the present length are known, exprb42 is used, which has one step, two stages and
    fourth order (Luan 2017). `tolerance`: as for `StageSolver`, of Krylov errors.
    """

    family = "exponential"
    weights: ClassVar[tuple[tuple[float, ...], ...]] = ()
    """w_ki: rows for k = 2, 3, ..., columns for i = 1, 2, ..."""
    default_tolerance = 1e-4
    courant, longest = 0.25, 10800.0
    # still stable in rough flow; a longer step saves nothing: docs/explanation/time_integration.md

    @classmethod
    def complete(cls) -> None:
        for m in range(2, cls.order):
            for j in range(cls.order - m):
                if not abs(error := _remainder(cls.weights, m, j)) <= ROUNDING:
                    raise ConfigError(
                        f"stepper {cls.name}: order {cls.order} requires `weights` that integrate"
                        f" J^{j} t^{m} exactly, which they miss by {error:.3g}"
                    )
        cls.error_constant = abs(_remainder(cls.weights, cls.order))

    def __init__(self, model: Model, dt: float, tolerance: float | None = None) -> None:
        solver = StageSolver(model.unpenalised(), self.solver_tolerance(tolerance))
        super().__init__(model, dt, solver)
        model, space, past = self.model, self.space, max(map(len, self.weights), default=0)
        self.counters |= {"rejected_steps": 0, "krylov_steps": 0}
        self._krylov = KrylovExponential(space, max(3, 1 + len(self.weights)))
        self._jacobian = model.jacobian()
        self._slope, self._drift, self._work = model.zeros(), model.zeros(), model.zeros()
        self._has_drift = not model.scene.autonomous
        self._states, self._slopes = ([model.zeros() for _ in range(past)] for _ in range(2))
        self._moved, self._bent = (space.stack(max(1, past)) for _ in range(2))

    def make_guesses(self, slope: wp.array) -> None:
        """Discard the previous steps."""
        self._known, self._spacing = 0, 0.0

    def numbers(self) -> dict[str, NDArray[Any]]:
        return super().numbers() | {"past": np.array([self._known, self._spacing])}

    def load_numbers(self, saved: dict[str, NDArray[Any]], steps: int) -> None:
        super().load_numbers(saved, steps)
        self._known, self._spacing = int(saved["past"][0]), float(saved["past"][1])

    def arrays(self) -> dict[str, wp.array]:
        states = {f"state_{i}": array for i, array in enumerate(self._states, 1)}
        slopes = {f"slope_{i}": array for i, array in enumerate(self._slopes, 1)}
        return {"state": self.state} | states | slopes

    def solve_step(self, t: float, dt: float, out: wp.array) -> str | None:
        self.model.tendency(self.state, t, self._slope)
        self._jacobian.update(self.state, t)
        self._prepare_sources(t, dt)
        known = self._known == len(self._states) and self._spacing == dt
        return self._multistep(dt, out) if known or not self.weights else self._one_step(t, dt, out)

    def accept(self, dt: float) -> None:
        for arrays, value in ((self._states, self.state), (self._slopes, self._slope)):
            if arrays:
                arrays.insert(0, arrays.pop())
                self.space.copy(value, arrays[0])
        self._known = min(len(self._states), 1 + (self._known if dt == self._spacing else 0))
        self._spacing = dt
        super().accept(dt)

    def _multistep(self, dt: float, out: wp.array) -> str | None:
        space, krylov = self.space, self._krylov
        for i in range(len(self._states)):
            space.axpby(-1.0, self.state, 1.0, self._states[i], self._moved[i])
            space.axpby(-1.0, self._slope, 1.0, self._slopes[i], self._bent[i])
            if self._has_drift:
                space.axpy((i + 1) * dt, self._drift, self._bent[i])
        for k, row in enumerate(self.weights, 1):
            c = np.array(row) / dt**k
            space.combine(krylov.moved[k], self._moved, -c, krylov.moved[k])
            space.combine(krylov.plain[k], self._bent, c, krylov.plain[k])
        return self._propagate(dt, dt, max(1 + len(self.weights), 1 + self._has_drift), out)

    def _one_step(self, t: float, dt: float, out: wp.array) -> str | None:
        """Set x+ = x + dt phi_1 F + 32/9 dt phi_3 R at x + 3/4 dt phi_1(3/4 dt J) F."""
        space, moved, bent = self.space, self._krylov.moved[2], self._krylov.plain[2]
        if (fault := self._propagate(STAGE * dt, dt, 1 + self._has_drift, out)) is not None:
            return fault
        weight = 2.0 / (STAGE * dt) ** 2
        self.model.tendency(out, t + STAGE * dt, bent)
        space.axpby(-weight, self._slope, weight, bent)
        if self._has_drift:
            space.axpy(-weight * STAGE * dt, self._drift, bent)
        space.axpby(-weight, out, weight, self.state, moved)
        return self._propagate(dt, dt, 3, out)

    def _propagate(self, length: float, dt: float, terms: int, out: wp.array) -> str | None:
        """Set out = state + the solution of the linear equations at `length`; return any fault."""
        goal = max(self.solver.tolerance * self.solver.rate * dt, self.solver.residual_floor())
        result = self._krylov.solve(self._jacobian, terms, length, goal, out)
        self.counters["krylov_iterations"] += result.iterations
        self.counters["krylov_steps"] += result.steps
        self.space.axpy(1.0, self.state, out)
        return result.fault

    def _prepare_sources(self, t: float, dt: float) -> None:
        """Compute F, and dF/dt for a wind or forcing that changes; other sources become 0."""
        space, krylov = self.space, self._krylov
        space.copy(self._slope, krylov.plain[0])
        for array in (*krylov.moved[1:], *krylov.plain[1:]):
            space.clear(array)
        if self._has_drift:
            first, *others = (DRIFT * 4.0 / dt).tolist()
            space.axpy(first, self._slope, krylov.plain[1])
            for quarter, weight in enumerate(others, 1):
                self.model.tendency(self.state, t + quarter * dt / 4.0, self._work)
                space.axpy(weight, self._work, krylov.plain[1])
            space.copy(krylov.plain[1], self._drift)


def _remainder(weights: tuple[tuple[float, ...], ...], m: int, j: int = 0) -> float:
    """Return C in the error C J^j dt^(m + j + 1) of a step for a remainder R = t^m/m!."""
    found = 1.0 / math.factorial(m + j + 1)
    for k, row in enumerate(weights, 2):
        values = sum(w * (-i) ** m for i, w in enumerate(row, 1))
        found -= values / (math.factorial(k + j) * math.factorial(m))
    return found


EPI2, EPI3, EPI4, EPI5 = read_methods(ExponentialMultistep, "EPI2", "EPI3", "EPI4", "EPI5")
