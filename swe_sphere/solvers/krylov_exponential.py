"""Linear equations whose sources are polynomials in time, solved by a Krylov method.

w' = A w + sum_k t^(k-1)/(k-1)! u_k from w(0) = 0 reaches sum_k T^k phi_k(T A) u_k at t = T: all
products of an exponential integrator at once. With w_j, the j-th derivative of w at a time s,
computed by p products with A, the solution continues as

    w(s + t) = sum_(j<p) t^j/j! w_j + t^p phi_p(t A) w_p

(Niesen & Wright 2012, phipm), of which only the last term needs a Krylov basis. As in KIOPS
(Gaudreault, Rainwater & Tokman 2018) the basis is orthogonalised incompletely. An error estimate
shows when it is large enough, or how far the largest one reaches; further steps cover the remaining
time.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.ranks.limits import check_stop
from swe_sphere.solvers.gmres import KrylovBasis
from swe_sphere.solvers.krylov import Operator
from swe_sphere.solvers.vector_space import VectorSpace


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
        """Approximate spectral radius of the skew part of A, for a basis by short recurrences."""
        m = self.columns
        couplings = np.diag(self._entries, -1)[: m - 1] - np.diag(self._entries, 1)[: m - 1]
        return float(couplings.mean()) if m > 1 else 0.0


SIZE = 100
"""Largest number of vectors of a basis: functions of a larger matrix cost more than they save."""
FIRST_LOOK = 5
APART = 16
"""The error is estimated each time the basis has grown by one over this number."""
SHORTER = 0.85
"""Factor that shortens a time which the largest basis does not reach."""
SHORTEST = 1e-4
"""Fraction of the whole time below which a step counts as a failure."""


@dataclass
class ExponentialResult:
    """A solve, in progress or finished, to `length` [s] with an error of at most `tolerance`.

    iterations: Krylov vectors; steps: steps taken; done: the time [s] that is reached; fault:
    description of a failure, if any.
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
    """Solver with `size` basis vectors and `terms` sources; keep it, as it allocates only once.

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

        The tolerance is one of the norm of out; if it is below the accuracy of the arithmetic, 0
        included, an error of round-off size meets it. After a fault `out` is meaningless.
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
        small, look, rows = SmallMatrix(self.size), FIRST_LOOK, self._basis.rows
        for k in range(self.size):
            check_stop()
            p.operator(rows[k], rows[k + 1])
            p.iterations += 1
            above, below = self._basis.extend(k + 1)
            if not math.isfinite(below):
                return 0.0, nothing
            small.append(above, below)
            if k + 1 >= min(look, self.size) or below == 0.0:
                coefficients, error = small.phi(p.terms, rest)
                if self._is_small(p, error, rest, size):
                    return rest, size * coefficients
                # waves need at least as many vectors as the phase [rad] of the fastest
                least = small.columns + 2 + small.columns // APART
                look = max(least, math.ceil(rest * small.radius()))
        t = SHORTER * min(rest, self.size / max(small.radius(), self.size / rest))
        while t > SHORTEST * p.length:
            coefficients, error = small.phi(p.terms, t)
            if self._is_small(p, error, t, size):
                return t, size * coefficients
            t *= SHORTER
        return 0.0, nothing

    def _is_small(self, p: ExponentialResult, error: float, t: float, size: float) -> bool:
        """Return whether an error after t is small enough, relative to the first vector."""
        least = self.space.epsilon * t**p.terms / math.factorial(p.terms)
        return error <= max(p.tolerance * t / p.length / size, least)
