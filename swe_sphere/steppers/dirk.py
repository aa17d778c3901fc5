"""Diagonally and linearly implicit Runge-Kutta methods: a method is its coefficients."""

import math
from typing import ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.steppers.stability import Rows, check_order, checked_tableau, error_constant
from swe_sphere.steppers.stepper import read_methods
from swe_sphere.steppers.variable_stepper import ImplicitStepper

ROUGH = 0.1
"""Relative tolerance of what is solved for an estimate."""
FRACTION = 1e-3
"""Spacing of the differences that give dF/dt, in time steps."""


class DiagonallyImplicit(ImplicitStepper):
    """Stages X_i = x + dt sum_j a_ij K_j, solved one after the other; x_new = x + dt sum_j b_j K_j.

    The slope K_i of an implicit stage is the one its solved equation implies, so that the step is
    consistent with it.  The guess for a stage is made with the slope the stage had one step before,
    and a part of what the slope of the stage before it has changed by since.
    """

    memory = "state", "slopes"  # those of the last step
    a: ClassVar[tuple[tuple[float, ...], ...]]
    """Rows of the tableau up to the diagonal."""
    b: ClassVar[tuple[float, ...]]
    embedded: ClassVar[tuple[float, ...] | None] = None
    """Weights of an embedded method of another order, where there is one."""
    followed: ClassVar[float] = 0.0
    """The part of a change of slope that the guess of the next stage follows.  Slow flow would have
    all of it, but so the noise of fast waves grows: it pays for tight tolerances."""

    @classmethod
    def complete(cls) -> None:
        matrix = checked_tableau(cls, "a")
        check_order(cls, matrix)
        cls.error_constant = error_constant(matrix, np.array(cls.b), cls.order)

    def allocate(self) -> None:
        stages = len(self.b)
        self._stack, self.slopes = self.space.stack(stages), self.space.stack(stages)
        self._slopes = [self._stack[i] for i in range(stages)]
        self.guesses = [self.slopes[i] for i in range(stages)]
        self._rhs, self._attempted = self.model.zeros(), 0.0

    def solve_step(self, t: float, dt: float, out: wp.array) -> str | None:
        for i, row in enumerate(self.a):
            earlier, gamma = dt * np.array(row[:i]), dt * row[i]
            stage_time = t + dt * sum(row)
            self.space.combine(self.state, self._stack, earlier, self._rhs)
            if gamma == 0.0:
                self.model.tendency(self._rhs, stage_time, self._slopes[i])
                continue
            # the stage that would have the slope guessed for it
            self.space.copy(self._rhs, out)
            self.space.axpy(gamma, self.guesses[i], out)
            if i > 0 and self.followed:
                self.space.axpy(self.followed * gamma, self._slopes[i - 1], out)
                self.space.axpy(-self.followed * gamma, self.guesses[i - 1], out)
            if fault := self.solver.solve(gamma, stage_time, self._rhs, out):
                return fault
            self.implied_slope(out, self._rhs, gamma, self._slopes[i])
        self._finish(dt, out)
        return None

    def _weights(self, b: tuple[float, ...]) -> NDArray[np.float64]:
        """Weights of the vectors in the stack for the weights b of the tableau."""
        return np.array(b)

    def _finish(self, dt: float, out: wp.array) -> None:
        """The state at the end of a step of dt [s] all of whose slopes are known."""
        self._attempted = dt
        self.space.combine(self.state, self._stack, dt * self._weights(self.b), out)

    def error_estimate(self) -> float:
        """Norm [m s-1] of the difference to the embedded method, for the step last attempted."""
        assert self.embedded is not None
        difference = self._attempted * (self._weights(self.b) - self._weights(self.embedded))
        self.space.clear(self._rhs)
        self.space.combine(self._rhs, self._stack, difference, self._rhs)
        return self.space.norm(self._rhs)

    def accept(self, dt: float) -> None:
        super().accept(dt)
        self.space.copy(self._stack, self.slopes)


ImplicitEuler, CrankNicolson, ImplicitMidpoint, SDIRK3, ESDIRK4 = read_methods(DiagonallyImplicit)


class TRBDF2(DiagonallyImplicit):
    """TR-BDF2: trapezoidal rule then BDF2, second order, L-stable (Bank et al. 1985).

    Embedded method of third order: Hosea & Shampine 1996, doi:10.1016/0168-9274(95)00115-8.
    """

    name, order = "tr-bdf2", 2
    style = ("#009E73", "d")
    default_tolerance = 1e-2
    estimate_order = 3
    _d, _w = 1.0 - math.sqrt(0.5), math.sqrt(2.0) / 4.0
    a = ((0.0,), (_d, _d), (_w, _w, _d))
    b = (_w, _w, _d)
    embedded = ((1.0 - _w) / 3.0, (3.0 * _w + 1.0) / 3.0, _d / 3.0)

    def error_estimate(self) -> float:
        """The norm [m s-1] of e with (I - gamma dt J) e = difference to the embedded method.

        That difference itself grows without bound for waves far faster than the step, which the
        scheme damps (Hosea & Shampine 1996); it is taken only where it is the smaller.
        """
        difference = super().error_estimate()
        problem, damped = self.solver.problem, self.space.zeros()
        problem.tau = self.a[-1][-1] * self._attempted
        problem.linearise(self.state)
        converged = self.solver.solve_linear(self._rhs, damped, rtol=ROUGH, guess=False).converged
        return min(difference, self.space.norm(damped)) if converged else difference


class Rosenbrock(DiagonallyImplicit):
    """Rosenbrock-W method: linearly implicit, one linear system with the same matrix a stage.

    (I - gamma dt J) k_i = dt F(x + sum a_ij k_j) + dt J sum_(j<i) g_ij k_j, x_new = x + sum b_i k_i
    keeps its order with an inexact J.  It is solved for u = Gamma k/dt: no product with J is on the
    right then (Hairer & Wanner 1996, IV.7).  A solve is as exact as `tolerance` says, relative to
    the change of the state in gamma dt.
    """

    gamma: ClassVar[float]
    alpha: ClassVar[Rows]
    """Rows of the a_ij from the second stage on, as those of `lower`, which are the g_ij."""
    lower: ClassVar[Rows]
    matrices: ClassVar[tuple[NDArray[np.float64], NDArray[np.float64]]]
    """The a_ij, and Gamma: the g_ij with gamma on the diagonal."""

    @classmethod
    def complete(cls) -> None:
        alpha, lower = (
            checked_tableau(cls, name, first=1, diagonal=False) for name in ("alpha", "lower")
        )
        cls.matrices = alpha, lower + cls.gamma * np.eye(len(cls.b))
        # for linear equations the method is a diagonally implicit one with this tableau
        both = alpha + cls.matrices[1]
        check_order(cls, alpha, both, nonlinear=1)
        cls.error_constant = error_constant(both, np.array(cls.b), cls.order)

    def allocate(self) -> None:
        super().allocate()
        self._point, self._drift = self.model.zeros(), self.model.zeros()
        self._has_drift = not self.model.scene.autonomous
        alpha, sums = self.matrices
        self._inverse = np.linalg.inv(sums)
        self._c, self._sums = alpha.sum(axis=1), sums.sum(axis=1)
        self._inner, self._coupling = alpha @ self._inverse, -np.tril(self._inverse, -1)

    def _weights(self, b: tuple[float, ...]) -> NDArray[np.float64]:
        return np.asarray(b @ self._inverse)

    def begin(self, slope: wp.array) -> None:
        """Guess the solutions that the slope at the start would have."""
        super().begin(slope)
        for guess, part in zip(self.guesses, self._sums, strict=True):
            self.space.scale(float(part), guess)

    def solve_step(self, t: float, dt: float, out: wp.array) -> str | None:
        space, solver, problem = self.space, self.solver, self.solver.problem
        goal = solver.tolerance * self.gamma * solver.rate
        problem.tau = self.gamma * dt
        solver.prepare(problem.tau)
        self._differentiate(t, dt)
        problem.time = t
        problem.linearise(self.state)
        for i in range(len(self.b)):
            # (I - tau J) u_i = gamma [F(x + dt sum a_ij u_j) + sum c_ij u_j + gamma_i dt dF/dt]
            space.combine(self.state, self._stack, dt * self._inner[i, :i], self._point)
            self.model.tendency(self._point, t + self._c[i] * dt, self._rhs)
            space.scale(self.gamma, self._rhs)
            space.combine(self._rhs, self._stack, self.gamma * self._coupling[i, :i], self._rhs)
            if self._has_drift:
                space.axpy(self.gamma * self._sums[i] * dt, self._drift, self._rhs)
            u = self._slopes[i]  # it has the mass of the right-hand side, which J does not move
            space.copy(self.guesses[i], u)
            result = solver.solve_linear(self._rhs, u, atol=goal, floor=solver.worthless() / dt)
            solver.restore_mass(self._rhs, u)
            if not result.converged:
                return result.message
        self._finish(dt, out)
        return None

    def _differentiate(self, t: float, dt: float) -> None:
        """dF/dt at the start, for a wind or forcing that changes, by differences.

        Forwards, as there need be nothing before the scene begins.
        """
        if not self._has_drift:
            return
        self.space.clear(self._drift)
        for ahead, weight in enumerate((-1.5, 2.0, -0.5)):
            self.model.tendency(self.state, t + ahead * FRACTION * dt, self._point)
            self.space.axpy(weight / (FRACTION * dt), self._point, self._drift)


(RosenbrockW,) = read_methods(Rosenbrock)
