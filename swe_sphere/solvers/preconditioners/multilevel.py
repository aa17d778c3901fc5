"""Approximate inverse of the Schur complement S by a coarse correction and Chebyshev steps."""

from typing import Any

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.equations.model import Model
from swe_sphere.operators.damping import Rate
from swe_sphere.operators.device_mesh import Field
from swe_sphere.operators.schur import SchurMatrix, SchurOperator
from swe_sphere.solvers.preconditioners.chebyshev import chebyshev_steps
from swe_sphere.solvers.preconditioners.coarse import CoarseCorrection

COURANT_A_STEP = 10.0
COURANT_A_CYCLE = 20.0
MOST_CYCLES = 4
"""Gravity-wave Courant numbers (root of the largest diagonal entry of S) from which one more
Chebyshev step, and for each of which one more cycle, pays."""
DEGREES = {3: 3, 4: 2}
"""Chebyshev steps by np, where not 4.  At np 3 all waves share their shortest wave, whose nodal
values are 1, 0, -1, 0: the coarse correction overshoots it, and two steps leave as much of it as
there was, so that the cycle is singular from some mesh on."""


def schur_operator(
    model: Model, coriolis: Array, real: Any, outer: Any, damping: Rate | None = None
) -> SchurOperator:
    """S of a model with that Coriolis parameter (N,) [s-1], in one number type inside.

    outer: number type of the states that it eliminates from and substitutes into; damping: of wind
    and depth by wavenumber, if any.
    """
    mesh = model.device_mesh.like(real, model.shape)
    return SchurOperator(mesh, model.launch, model.scene.planet.gravity, coriolis, outer, damping)


class Multilevel:
    """Cycles of a coarse correction, of smooth waves and computational modes, and Chebyshev steps.

    At large gravity-wave Courant numbers a Chebyshev step and more cycles are added.  With
    `symmetric`, as many steps go before the correction, as conjugate gradients need.
    """

    def __init__(self, operator: SchurOperator, symmetric: bool = False) -> None:
        self.operator = operator
        self.matrix = SchurMatrix(operator.mesh.mesh, operator.gravity, operator.coriolis)
        self._symmetric = symmetric
        self._coarse = CoarseCorrection(self.matrix, operator, symmetric)
        self._direction, self._rest = operator.field(), operator.field()

    def setup(self, tau: float, depth: Array) -> None:
        """Prepare for the implicit step tau [s] and the depth (N,) [m] of the operator."""
        diagonal = self.matrix.diagonal(tau, depth)
        courant = float(np.sqrt(diagonal.max()))
        degree = DEGREES.get(self.operator.mesh.mesh.np, 4) + (courant > COURANT_A_STEP)
        self._steps = chebyshev_steps(self.operator, degree, diagonal)
        self._coarse.setup(tau, depth)
        self._cycles = min(1 + int(courant / COURANT_A_CYCLE), MOST_CYCLES)

    def solve(self, b: Field, x: Field) -> None:
        """x near S^-1 b; b is overwritten."""
        for cycle in range(self._cycles):
            if cycle > 0 or self._symmetric:
                wp.copy(self._rest.values, b.values)
                self._smooth(self._rest, x, from_zero=cycle == 0)
                self.operator.residual(b, x, self._rest)
                self._coarse.correct(self._rest, x)
            else:
                x.values.zero_()
                self._coarse.correct(b, x)
            if self._symmetric and cycle < self._cycles - 1:
                wp.copy(self._rest.values, b.values)
                self._smooth(self._rest, x)
        self._smooth(b, x)

    def _smooth(self, r: Field, x: Field, from_zero: bool = False) -> None:
        """Chebyshev steps from x or from zero; r, the right-hand side, is overwritten."""
        first, *others = self._steps
        if from_zero:
            self.operator.chebyshev_start(first, r, self._direction, x)
        else:
            wp.copy(self._direction.values, x.values)
            self.operator.chebyshev_step(first, r, self._direction, x)
        for step in others:
            self.operator.chebyshev_step(step, r, self._direction, x)
