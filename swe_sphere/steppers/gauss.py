"""The Gauss-Legendre method of two stages, which are solved together."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.model import Model
from swe_sphere.solvers.preconditioners import Preconditioner, make_preconditioner
from swe_sphere.solvers.vector_space import VectorSpace
from swe_sphere.steppers.implicit import ImplicitStepper, StageProblem
from swe_sphere.steppers.stability import error_constant
from swe_sphere.steppers.stage_solver import energy_space

_ROOT = math.sqrt(3.0)
A = ((0.25, 0.25 - _ROOT / 6.0), (0.25 + _ROOT / 6.0, 0.25))
B = (0.5, 0.5)
C = (0.5 - _ROOT / 6.0, 0.5 + _ROOT / 6.0)
INVERSE = np.linalg.inv(np.array(A))
AHEAD = (np.array(C) + 1.0 - C[0]) / (C[1] - C[0])
EXTRAPOLATION = np.stack([1.0 - AHEAD, AHEAD], axis=1)
"""Matrix (2, 2) that extrapolates the slopes of a step linearly to those of the next."""
DIAGONAL = (A[0][0], A[1][1] - A[1][0] * A[0][1] / A[0][0])
"""Diagonal of the lower triangle LD in A = L D U: 1/4 and 1/3."""


class ForwardElimination(Preconditioner):
    """Approximate inverse of I - dt A (x) J for a pair of stages in one vector (2n,).

    Of A = L D U it keeps the lower triangle LD; A equals LD times a factor whose eigenvalues are
    all 1 (Rana et al. 2021, doi:10.1137/20M1389030). It eliminates forwards: y_1 = (I - d_1 dt
    J)^-1 r_1, y_2 = (I - d_2 dt J)^-1 (r_2 + a_21 dt J y_1), with dt J y_1 = (y_1 - r_1)/d_1.
    """

    def __init__(self, model: Model, space: VectorSpace, parts: list[Preconditioner]) -> None:
        """Store the space of one stage, and one preconditioner in `parts` per implicit step."""
        self._space, self._parts, self._work = space, parts, model.zeros()

    def setup(self, state: wp.array, tau: float) -> None:
        for part, diagonal in zip(self._parts, DIAGONAL, strict=True):
            part.update(state, diagonal * tau)

    def apply(self, r: wp.array, out: wp.array) -> None:
        n, space, factor = self._space.n, self._space, A[1][0] / DIAGONAL[0]
        self._parts[0](r[:n], out[:n])
        space.axpby(factor, out[:n], 1.0, r[n:], self._work)
        space.axpy(-factor, r[:n], self._work)
        self._parts[1](self._work, out[n:])

    def state_dict(self) -> dict[str, NDArray[Any]]:
        numbered = enumerate(part.state_dict() for part in self._parts)
        return {f"{name}_{i}": value for i, mine in numbered for name, value in mine.items()}

    def load_state_dict(self, state: Mapping[str, NDArray[Any]]) -> None:
        for i, part in enumerate(self._parts):
            end = f"_{i}"
            mine = {k.removesuffix(end): v for k, v in state.items() if k.endswith(end)}
            part.load_state_dict(mine)


class CoupledStages(StageProblem):
    """X_i - x - dt sum_j a_ij F(X_j) = 0 for the pair of stages in one vector (2n,).

    Each stage has its own Jacobian, so that Newton converges quadratically at any step.
    """

    def __init__(self, model: Model, single: VectorSpace, preconditioner: str) -> None:
        """Create the problem; `single` is the space of one stage."""
        linear = model.for_solves
        one = single if linear is model else energy_space(linear)
        self._model, self._single, self._linear_single = model, single, one
        # means over the stages, so that a tolerance has its meaning for one state
        self.space, self.linear_space = (energy_space(each, len(C)) for each in (model, linear))
        parts = [made for _ in C if (made := make_preconditioner(preconditioner, linear))]
        self.precondition = ForwardElimination(linear, one, parts) if parts else None
        self._slopes, self._images = single.stack(len(C)), one.stack(len(C))
        self._jacobians = [linear.jacobian() for _ in C]
        self.converted = one.converted

    def residual(self, x: wp.array, out: wp.array) -> None:
        """Set out_i = X_i - x - dt sum_j a_ij F(X_j)."""
        for i, stage in enumerate(split(x)):
            self._model.tendency(stage, self.time + C[i] * self.tau, self._slopes[i])
        for i, (stage, mine) in enumerate(zip(split(x), split(out), strict=True)):
            self._single.combine(stage, self._slopes, -self.tau * np.array(A[i]), mine)
            self._single.axpy(-1.0, self.rhs, mine)

    def linearise(self, x: wp.array) -> None:
        for jacobian, stage, c in zip(self._jacobians, split(x), C, strict=True):
            jacobian.update(self.converted(stage), self.time + c * self.tau)

    def jacobian(self, d: wp.array, out: wp.array) -> None:
        """Set out_i = d_i - dt sum_j a_ij J(X_j) d_j."""
        directions = split(d)
        for i, jacobian in enumerate(self._jacobians):
            jacobian(directions[i], self._images[i])
        for direction, row, mine in zip(directions, A, split(out), strict=True):
            self._linear_single.combine(direction, self._images, -self.tau * np.array(row), mine)

    def masses(self, x: wp.array) -> list[tuple[wp.array, wp.array, float]]:
        sources = np.array([self._model.mean_source(self.time + c * self.tau) for c in C])
        gains = self.tau * np.array(A) @ sources
        return [(self.rhs, stage, float(gain)) for stage, gain in zip(split(x), gains, strict=True)]


def split(pair: wp.array) -> tuple[wp.array, wp.array]:
    """Return the two stages (n,) of a pair (2n,), as views."""
    n = pair.size // 2
    return pair[:n], pair[n:]


class GaussLegendre(ImplicitStepper):
    """Gauss-Legendre, two coupled stages: fourth order, symplectic, no damping.

    The step is consistent with the solved stages: x_new = x + sqrt(3) (X_2 - X_1), which is
    x + dt/2 (K_1 + K_2) with the slopes that the stages imply.  The guess extrapolates old slopes.
    """

    name, order = "gauss-legendre", 4
    default_tolerance = 1e-4
    error_constant = error_constant(np.array(A), np.array(B), order)

    equations = CoupledStages
    memory = "state", "slopes"  # slopes of the last step

    def allocate(self) -> None:
        self.slopes = self.space.stack(len(C))
        self.guesses = [self.slopes[i] for i in range(len(C))]
        self._pair = self.solver.problem.space.zeros()
        # solved stages less the state: exactly zero at rest
        self._changes = self._pair.reshape((len(C), self.space.n))

    def solve_step(self, t: float, dt: float, out: wp.array) -> str | None:
        stages = split(self._pair)
        for stage, row in zip(stages, dt * np.array(A) @ EXTRAPOLATION, strict=True):
            self.space.combine(self.state, self.slopes, row, stage)
        if fault := self.solver.solve(dt, t, self.state, self._pair):
            return fault
        for stage in stages:
            self.space.axpy(-1.0, self.state, stage)
        self.space.combine(self.state, self._changes, (-_ROOT, _ROOT), out)
        return None

    def accept(self, dt: float) -> None:
        """Make `new` the present state, and keep the slopes for the guess of the next step."""
        for guess, (a, b) in zip(self.guesses, (INVERSE / dt).tolist(), strict=True):
            self.space.axpby(b, self._changes[1], a, self._changes[0], guess)
        super().accept(dt)
