"""Explicit Runge-Kutta methods, each defined by its Butcher tableau."""

from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError
from swe_sphere.kernels.simd.stages import mix
from swe_sphere.steppers import stability
from swe_sphere.steppers.stepper import Stepper, read_methods


class RungeKutta(Stepper):
    """Explicit Runge-Kutta method with stages K_i = F(x + dt sum_j a_ij K_j, t + c_i dt).

    No slope is stored: a stage adds its slope to a combination of the previous levels, which
    contain the earlier slopes (see `kernels/simd/stages.py`).
    """

    a: ClassVar[tuple[tuple[float, ...], ...]]
    """Rows of the tableau below the diagonal, from the second stage on."""
    b: ClassVar[tuple[float, ...]]
    repeats_from = 0

    @classmethod
    def complete(cls) -> None:
        stability.check_order(cls, stability.checked_tableau(cls, "a", first=1, diagonal=False))
        cls.reach, cls.fused_steps = 2.0 * len(cls.b), -(-8 // len(cls.b))

    def __init__(self, model: Model, dt: float) -> None:
        super().__init__(model, dt)
        stack = wp.zeros((len(self.a), model.size), dtype=self.state.dtype, device=model.device)
        levels = [*(stack[i] for i in range(len(self.a))), self.state]
        offsets = dt * np.array([0.0, *(sum(row) for row in self.a)])
        mesh, point, mixed, alone = model.device_mesh, self.state, model.zeros(), len(self.b) == 1
        self._mix = mesh.over_nodes(mix)
        self._stages: list[tuple[Any, ...]] = []
        """Tuples (terms, start, rhs, point, offset, level): a stage is level = start + dt share
        K(point, offset), where `start` contains the sum of earlier levels in `terms`."""
        for (weights, share), offset, level in zip(self._sums(), offsets, levels, strict=True):
            (used,), terms, start = np.nonzero(weights), None, self.state
            if alone or used.size:
                first, last = (int(used[0]), int(used[-1]) + 1) if used.size else (0, 0)
                terms = stack, mesh.upload(weights), first, last
                start = mixed if share else model.zeros()
            rhs = self.model.right_hand_side(stage=(start, dt * (share or 1.0)))
            where = start if alone else point  # other than the output array
            self._stages.append((terms, start, rhs, where, offset, level))
            point = level if share else start

    def advance(self) -> None:
        size, fields = self.model.device_mesh.size, len(self.model.names)
        for terms, start, rhs, point, offset, level in self._stages:
            if terms is not None:  # start = x + sum_k w_k (level_k - x)
                self._mix(size, fields, self.state, *terms, start)
            rhs(point, self.time + offset, level)

    @classmethod
    def _sums(cls) -> Iterator[tuple[Array, float]]:
        """Yield for each row the weights of the levels above it, and its share of the last slope.

        If it has no share, the row's level contains all of that slope, for the rows below. Raises
        ConfigError if the last slope is unused.
        """
        rows = stability.tableau((*cls.a, cls.b), 1 + len(cls.b))[1:, :-1]
        triangle = rows + np.diag(rows.diagonal() == 0.0)
        if not rows[-1, -1]:
            raise ConfigError(f"{cls.name}: the last number of `b` is 0: leave out the last stage")
        for i, row in enumerate(rows):
            yield np.linalg.solve(triangle[:i, :i].T, row[:i]), row[i]

    @classmethod
    def amplification(cls, z_wave: stability.Complex, z_dissipation: stability.Complex) -> Array:
        """Return |R(z)| for the sum z of both parts."""
        a = stability.tableau(cls.a, len(cls.b))
        return stability.runge_kutta_factor(np.array(cls.b), (a, z_wave + z_dissipation))


RK4, SSPRK3, KG5 = read_methods(RungeKutta, "RK4", "SSPRK3", "KG5")
