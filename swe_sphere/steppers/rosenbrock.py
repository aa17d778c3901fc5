"""Linearly implicit Runge-Kutta methods: one linear system a stage, no Newton iteration."""

from typing import ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.steppers.dirk import DiagonallyImplicit
from swe_sphere.steppers.stability import Rows, check_order, checked_tableau, error_constant
from swe_sphere.steppers.stepper import read_methods

FRACTION = 1e-3
"""Spacing of the differences that give dF/dt, in time steps."""


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
        weights: NDArray[np.float64] = b @ self._inverse
        return weights

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
            self._right_hand_side(i, t, dt)
            # (I - tau J) u_i = right-hand side; u_i has its mass, which J does not move
            u = self._slopes[i]
            space.copy(self.guesses[i], u)
            result = solver.solve_linear(self._rhs, u, atol=goal, floor=solver.worthless() / dt)
            solver.restore_mass(self._rhs, u)
            if not result.converged:
                return result.message
        self._finish(dt, out)
        return None

    def _right_hand_side(self, i: int, t: float, dt: float) -> None:
        """gamma [F(x + dt sum a_ij u_j) + sum c_ij u_j + gamma_i dt dF/dt]."""
        space = self.space
        space.combine(self.state, self._stack, dt * self._inner[i, :i], self._point)
        self.model.tendency(self._point, t + self._c[i] * dt, self._rhs)
        space.scale(self.gamma, self._rhs)
        space.combine(self._rhs, self._stack, self.gamma * self._coupling[i, :i], self._rhs)
        if self._has_drift:
            space.axpy(self.gamma * self._sums[i] * dt, self._drift, self._rhs)

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
