"""Exponential multistep methods: the linear part exactly, the remainder from previous steps."""

from math import factorial
from typing import Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.model import Model
from swe_sphere.solvers.krylov_exponential import KrylovExponential
from swe_sphere.steppers.implicit import VariableStepper
from swe_sphere.steppers.stage_solver import StageSolver
from swe_sphere.steppers.stepper import read_methods

STAGE = 0.75
"""Time of the second stage of the one-step method, in time steps."""
DRIFT = np.array([-25 / 12, 4.0, -3.0, 4 / 3, -1 / 4])
"""Weights of values at quarters of a step in the derivative at its beginning, of fourth order."""


class ExponentialMultistep(VariableStepper):
    """An exponential propagation iterative (EPI) method of several steps, defined by its weights.

    x+ = x + dt phi_1 F + dt sum_k phi_k sum_i w_ki R_i, R_i = F(x_i) - F(x) - J (x_i - x) of i
    steps before, phi_k those of dt J with the exact J at x (Tokman 2006). Explicit dependence on
    time is a further variable: R_i contains - dF/dt (t_i - t), and dt^2 phi_2 dF/dt is added. The
    first steps, and those of another length than the one before, use exprb42, which has one step,
    two stages and fourth order (Luan 2017). `tolerance`: as for `StageSolver`, of the error of the
    Krylov solver in a step.
    """

    family = "exponential"
    weights: ClassVar[tuple[tuple[float, ...], ...]] = ()
    """w_ki: rows for k = 2, 3, ..., columns for i = 1, 2, ..."""
    default_tolerance = 1e-4
    courant, longest = 0.25, 10800.0
    # still stable in rough flow; a longer step saves nothing: docs/howto/steppers.md

    @classmethod
    def complete(cls) -> None:
        cls.error_constant = abs(_remainder(cls.weights, cls.order))

    def __init__(self, model: Model, dt: float, tolerance: float | None = None) -> None:
        solver = StageSolver(model.unpenalised(), self.solver_tolerance(tolerance))
        super().__init__(model, dt, solver)
        model = self.model
        space, past = self.space, len(self.weights[0]) if self.weights else 0
        self.counters |= {"rejected_steps": 0, "krylov_steps": 0}
        terms = max(3, 1 + len(self.weights))
        self._krylov = KrylovExponential(space, terms)
        self._jacobian = model.jacobian()
        self._slope, self._drift, self._work = model.zeros(), model.zeros(), model.zeros()
        self._has_drift = not model.scene.autonomous
        self._states = [model.zeros() for _ in range(past)]
        self._slopes = [model.zeros() for _ in range(past)]
        self._moved, self._bent = (space.stack(max(1, past)) for _ in range(2))

    def begin(self, slope: wp.array) -> None:
        """Discard the previous steps."""
        self._known, self._spacing = 0, 0.0

    def numbers(self) -> dict[str, NDArray[Any]]:
        return super().numbers() | {"past": np.array([self._known, self._spacing])}

    def load_numbers(self, state: dict[str, NDArray[Any]], steps: int) -> None:
        super().load_numbers(state, steps)
        self._known, self._spacing = int(state["past"][0]), float(state["past"][1])

    def arrays(self) -> dict[str, wp.array]:
        states = {f"state_{i}": array for i, array in enumerate(self._states, 1)}
        slopes = {f"slope_{i}": array for i, array in enumerate(self._slopes, 1)}
        return {"state": self.state} | states | slopes

    def solve_step(self, t: float, dt: float, out: wp.array) -> str | None:
        self.model.tendency(self.state, t, self._slope)
        self._jacobian.update(self.state, t)
        self._prepare_sources(t, dt)
        known = self._known == len(self._states) and self._spacing == dt
        if known or not self.weights:
            return self._multistep(dt, out)
        return self._one_step(t, dt, out)

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
            for past, present, change in (
                (self._states[i], self.state, self._moved[i]),
                (self._slopes[i], self._slope, self._bent[i]),
            ):
                space.axpby(-1.0, present, 1.0, past, change)
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
        fault = self._propagate(STAGE * dt, dt, 1 + self._has_drift, out)
        if fault is not None:
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
        solver = self.solver
        goal = max(solver.tolerance * solver.rate * dt, solver.worthless())
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


def _remainder(weights: tuple[tuple[float, ...], ...], order: int) -> float:
    """Return C in the error C dt^(p + 1) of a step for a remainder R = t^p/p!, p = order, J = 0."""
    found = 1.0 / factorial(order + 1)
    for k, row in enumerate(weights, 2):
        values = sum(w * (-i) ** order for i, w in enumerate(row, 1))
        found -= values / (factorial(k) * factorial(order))
    return found


EPI2, EPI3, EPI4, EPI5 = read_methods(ExponentialMultistep)
