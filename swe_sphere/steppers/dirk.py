"""Diagonally implicit Runge-Kutta methods, defined by their coefficients, and BDF2."""

import math
from typing import ClassVar

import numpy as np
import warp as wp

from swe_sphere.errors import ConfigError
from swe_sphere.steppers.implicit import ImplicitStepper
from swe_sphere.steppers.stability import check_order, checked_tableau, error_constant
from swe_sphere.steppers.stepper import read_methods

EXTRAPOLATED_SHARE = 0.3
"""Fraction of the last change of slope that the guess of BDF2 extrapolates.  Balanced (slow) flow
permits all of it, but that would double the noise of unresolved waves."""
LARGEST_RATIO = 2.0
"""Largest ratio of successive steps for which BDF2 uses its past level (stable up to 2.4)."""
ROUGH = 0.1
"""Relative tolerance of solves for error estimates."""


class DiagonallyImplicit(ImplicitStepper):
    """Stages X_i = x + dt sum_j a_ij K_j, solved one after the other; x_new = x + dt sum_j b_j K_j.

    The slope K_i of an implicit stage is implied by its solved equation, so that the step is
    consistent with it. The guess for a stage uses its slope one step before, and a fraction of the
    change since then of the previous stage's slope.
    """

    memory = "state", "slopes"  # slopes of the last step
    a: ClassVar[tuple[tuple[float, ...], ...]]
    """Rows of the tableau up to the diagonal."""
    b: ClassVar[tuple[float, ...]]
    embedded: ClassVar[tuple[float, ...] | None] = None
    """Weights of an embedded method of another order, if any."""
    followed: ClassVar[float] = 0.0
    """Fraction of a change of slope that the guess of the next stage extrapolates.  Balanced
    (slow) flow permits all of it, but noise of fast waves grows; tight tolerances favour it."""

    @classmethod
    def complete(cls) -> None:
        matrix = checked_tableau(cls, "a")
        if matrix.diagonal().min() < 0.0:
            raise ConfigError(f"stepper {cls.name}: the diagonal of `a` must not be negative")
        check_order(cls, matrix)
        if cls.embedded is not None:
            power = cls.estimate_order or 0
            is_other = len(cls.embedded) == len(cls.b) and not np.allclose(cls.embedded, cls.b)
            if not is_other or not 2 <= power <= cls.order + 1:
                raise ConfigError(
                    f"stepper {cls.name}: `embedded` must have {len(cls.b)} weights other than `b`,"
                    f" and `estimate_order` must be from 2 to {cls.order + 1}, got {cls.embedded}"
                    f" and {cls.estimate_order}"
                )
            check_order(cls, matrix, weights=cls.embedded, order=power - 1)
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
            # the stage with the guessed slope
            self.space.axpby(gamma, self.guesses[i], 1.0, self._rhs, out)
            if i > 0 and self.followed:
                self.space.axpy(self.followed * gamma, self._slopes[i - 1], out)
                self.space.axpy(-self.followed * gamma, self.guesses[i - 1], out)
            if fault := self.solver.solve(gamma, stage_time, self._rhs, out):
                return fault
            self.implied_slope(out, self._rhs, gamma, self._slopes[i])
        self._attempted = dt
        self.space.combine(self.state, self._stack, dt * np.array(self.b), out)
        return None

    def error_estimate(self) -> float:
        """Return the norm [m s-1] of the last attempt's difference from the embedded method."""
        assert self.embedded is not None
        difference = self._attempted * (np.array(self.b) - np.array(self.embedded))
        self.space.clear(self._rhs)
        self.space.combine(self._rhs, self._stack, difference, self._rhs)
        return self.space.norm(self._rhs)

    def accept(self, dt: float) -> None:
        super().accept(dt)
        self.space.copy(self._stack, self.slopes)


ImplicitEuler, CrankNicolson, ImplicitMidpoint, SDIRK3, ESDIRK4 = read_methods(
    DiagonallyImplicit, "ImplicitEuler", "CrankNicolson", "ImplicitMidpoint", "SDIRK3", "ESDIRK4"
)


class TRBDF2(DiagonallyImplicit):
    """TR-BDF2: trapezoidal rule then BDF2, second order, L-stable (Bank et al. 1985).

    Embedded method of third order: Hosea & Shampine 1996, doi:10.1016/0168-9274(95)00115-8.
    """

    name, order = "tr-bdf2", 2
    default_tolerance, splits_penalty = 1e-2, True
    estimate_order = 3
    _d, _w = 1.0 - math.sqrt(0.5), math.sqrt(2.0) / 4.0
    a = ((0.0,), (_d, _d), (_w, _w, _d))
    b = (_w, _w, _d)
    embedded = ((1.0 - _w) / 3.0, (3.0 * _w + 1.0) / 3.0, _d / 3.0)

    def error_estimate(self) -> float:
        """Return the norm [m s-1] of e, (I - gamma dt J) e = difference from the embedded method.

        The difference itself grows without bound for waves far faster than the step, which the
        scheme damps (Hosea & Shampine 1996); it is used if it is smaller, or if the solve fails.
        """
        difference = super().error_estimate()
        tau = self.a[-1][-1] * self._attempted
        return min(difference, self.solver.norm_of_solution(tau, self.state, self._rhs, ROUGH))


class BDF2(ImplicitStepper):
    """BDF2: second order, one solve a step, damps fast waves; started by TR-BDF2.

    Variable steps: with w the ratio of the step to the one before, x+ - dt (1+w)/(1+2w) F(x+) =
    [(1+w)^2 x - w^2 x-]/(1+2w) (Hairer, Norsett & Wanner 1993, III.5).
    """

    name, order = "bdf2", 2
    default_tolerance = 1e-2
    memory = "state", "previous"
    splits_penalty, penalised_at = True, 1.0
    error_constant = 2.0 / 9.0  # for equal steps (Hairer, Norsett & Wanner 1993, III.2)

    def allocate(self) -> None:
        if self.splits_diffusion:
            raise ConfigError("bdf2: diffusion=apart would be of first order: use diffusion=whole")
        self.previous, self._rhs = self.model.zeros(), self.model.zeros()
        self._starter = TRBDF2(self.model, self.dt, solver=self.solver)

    def solve_step(self, t: float, dt: float, out: wp.array) -> str | None:
        before = self.solver.last_dt
        if before == 0.0 or dt > LARGEST_RATIO * before:  # extrapolation would be unstable
            starter = self._starter
            starter.start(self.state, t)
            self.solver.aim(starter.state, starter.error_constant, starter.order, dt)
            # some more iterations with the set-up of later steps cost less than a second set-up
            self.solver.prepared_for = 2.0 / 3.0 * dt
            try:
                return starter.solve_step(t, dt, out)
            finally:
                self.solver.prepared_for = None
        w = dt / before
        # from the difference: in float32 the sum of both factors is not exactly one
        self.space.axpby(1.0, self.state, -1.0, self.previous, self._rhs)
        self.space.axpby(1.0, self.state, w**2 / (1.0 + 2.0 * w), self._rhs)
        slope, curvature = self.solver.mean_slope, self.solver.curvature
        bend = 0.5 * EXTRAPOLATED_SHARE * dt * (dt + before)
        self.model.launch.combine(self.state, slope, dt, curvature, bend, out=out)
        return self.solver.solve(dt * (1.0 + w) / (1.0 + 2.0 * w), t + dt, self._rhs, out)

    def accept(self, dt: float) -> None:
        super().accept(dt)
        self.previous, self.new = self.new, self.previous
