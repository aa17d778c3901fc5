"""Explicit Runge-Kutta methods: a method is its Butcher tableau."""

from collections.abc import Iterator
from typing import ClassVar, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.model import Model
from swe_sphere.equations.right_hand_side import RightHandSide
from swe_sphere.errors import ConfigError
from swe_sphere.steppers.combinations import Mixer
from swe_sphere.steppers.stability import (
    Complex,
    check_order,
    checked_tableau,
    runge_kutta_growth,
    tableau,
)  # fmt: skip
from swe_sphere.steppers.stepper import Stepper, read_methods


class _Stage(NamedTuple):
    """level = start + dt share K(point, offset), with `start` mixed of the levels before."""

    mixer: Mixer | None
    start: wp.array
    point: wp.array
    offset: float
    rhs: RightHandSide
    level: wp.array


class RungeKutta(Stepper):
    """Explicit Runge-Kutta method with stages K_i = F(x + dt sum_j a_ij K_j, t + c_i dt).

    No slope is kept: a stage adds its own to what the levels before it tell of theirs (see
    `kernels/simd/stages.py`).
    """

    a: ClassVar[tuple[tuple[float, ...], ...]]
    """Rows of the tableau below the diagonal, from the second stage on."""
    b: ClassVar[tuple[float, ...]]
    repeats_from = 0

    @classmethod
    def complete(cls) -> None:
        check_order(cls, checked_tableau(cls, "a", first=1, diagonal=False))
        cls.reach = 2.0 * len(cls.b)

    def __init__(self, model: Model, dt: float) -> None:
        super().__init__(model, dt)
        stack = wp.zeros((len(self.a), model.size), dtype=self.state.dtype, device=model.device)
        levels = [*(stack[i] for i in range(len(self.a))), self.state]
        offsets = dt * np.array([0.0, *(sum(row) for row in self.a)])
        point, mixed, alone = self.state, model.zeros(), len(self.b) == 1
        self._stages: list[_Stage] = []
        for (weights, share), offset, level in zip(self._sums(), offsets, levels, strict=True):
            mixer = Mixer(model, stack, weights) if alone or weights.any() else None
            start = self.state if mixer is None else mixed if share else model.zeros()
            rhs = self.model.right_hand_side(stage=(start, dt * (share or 1.0)))
            where = start if alone else point  # not what is written
            self._stages.append(_Stage(mixer, start, where, offset, rhs, level))
            point = level if share else start

    def advance(self) -> None:
        for stage in self._stages:
            if stage.mixer is not None:
                stage.mixer(self.state, stage.start)
            stage.rhs(stage.point, self.time + stage.offset, stage.level)

    @classmethod
    def _sums(cls) -> Iterator[tuple[NDArray[np.float64], float]]:
        """Of each row the weights of the levels above it, and its share of the slope before it.

        Where it has none of that slope, the level it leads to has all of it, to tell those below.
        Raises ConfigError where the last slope is for nothing.
        """
        rows = tableau((*cls.a, cls.b), 1 + len(cls.b))[1:, :-1]
        told = rows + np.diag(rows.diagonal() == 0.0)
        if not rows[-1, -1]:
            raise ConfigError(f"{cls.name}: the last number of `b` is 0: leave out the last stage")
        for i, row in enumerate(rows):
            yield np.linalg.solve(told[:i, :i].T, row[:i]), row[i]

    @classmethod
    def growth(cls, z_wave: Complex, z_dissipation: Complex) -> NDArray[np.float64]:
        """|R(z)| for the sum z of both parts."""
        a = tableau(cls.a, len(cls.b))
        return runge_kutta_growth(np.array(cls.b), (a, z_wave + z_dissipation))


RK4, SSPRK3, KG5 = read_methods(RungeKutta)
