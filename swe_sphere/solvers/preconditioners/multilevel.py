"""Approximate inverse of the Schur complement S by a coarse correction and Chebyshev steps."""

from typing import Any

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.equations.model import Model
from swe_sphere.operators.device_mesh import Field
from swe_sphere.operators.schur import Rate, SchurOperator
from swe_sphere.solvers.preconditioners.chebyshev import chebyshev_steps, schur_bound
from swe_sphere.solvers.preconditioners.coarse import CoarseCorrection

DEGREES = {3: 3, 4: 2}
"""Number of Chebyshev steps after the last correction by np, else 4.  At np 3 smooth functions and
computational modes both contain the wave with nodal values 1, 0, -1, 0: their corrections, added
up, overshoot it, and two steps do not reduce it: the cycle would be singular on large meshes."""
FIRST_STEPS = 2
"""Number of Chebyshev steps before the first correction for conjugate gradients."""
LONG = 10.0
"""Gravity-wave Courant number (root of the largest diagonal entry of S) above which a second cycle
pays off, with one more Chebyshev step after the last correction."""
COURANT_A_CYCLE, MOST_CYCLES = 20.0, 4
"""Each such increase of the gravity-wave Courant number adds a cycle, up to MOST_CYCLES."""
COURANT_A_STEP, LEAST_STEPS, MOST_STEPS, VERY_LONG = 2.2, 4, 16, 40.0
"""Above np 4 without diffusion a cycle has a Chebyshev step for each COURANT_A_STEP of the Courant
number, within these limits; above VERY_LONG there are two cycles."""


def schur_operator(
    model: Model, coriolis: Array, real: Any, outer: Any, damping: Rate | None = None
) -> SchurOperator:
    """Return S of a model with that Coriolis parameter (N,) [s-1], in the number type `real`.

    outer: number type of the states that it eliminates from and substitutes into; damping: rate of
    wind and depth by k^2 [m-2], if any.
    """
    mesh = model.device_mesh.like(real, model.shape)
    return SchurOperator(mesh, model.scene.planet.gravity, coriolis, outer, damping)


class Multilevel:
    """Cycles of a coarse correction, of smooth waves and computational modes, and Chebyshev steps.

    Large gravity-wave Courant numbers add Chebyshev steps and cycles. With `smooths_first`, steps
    precede the first correction too, which saves iterations of conjugate gradients.
    """

    def __init__(self, operator: SchurOperator, smooths_first: bool = False) -> None:
        self.operator = operator
        self._smooths_first = smooths_first
        self._coarse = CoarseCorrection(operator)
        self._rest = operator.field()

    def setup(self, tau: float, depth: Array) -> None:
        """Prepare for the implicit step tau [s] and the depth (N,) [m] of the operator."""
        courant, largest = float(np.sqrt(self.operator.diagonal.max())), schur_bound(self.operator)
        np_, is_long = self.operator.mesh.mesh.np, courant > LONG
        if np_ > 4 and self.operator.damping is None:
            last = min(max(round(courant / COURANT_A_STEP), LEAST_STEPS), MOST_STEPS)
            between, self._cycles = last // 2, 1 + (courant > VERY_LONG)
        else:
            steps = DEGREES.get(np_, 4)
            last, between = steps + is_long, steps - 1
            self._cycles = max(min(1 + int(courant / COURANT_A_CYCLE), MOST_CYCLES), 1 + is_long)
        self._first, self._between, self._last = (
            chebyshev_steps(n, largest) for n in (FIRST_STEPS, between, last)
        )
        self._coarse.setup(tau, depth)

    def solve(self, b: Field, x: Field) -> None:
        """Set x to about S^-1 b."""
        for cycle in range(self._cycles):
            if cycle > 0:
                self._smooth(self._between, b, x)
            elif self._smooths_first:
                size, *steps = self._first
                self.operator.chebyshev_start(size, b, x)
                self._smooth(steps, b, x)
            else:
                self._coarse.correct(b, x, add=False)
                continue
            self.operator.residual(b, x, self._rest)
            self._coarse.correct(self._rest, x)
        self._smooth(self._last, b, x)

    def _smooth(self, sizes: list[float], b: Field, x: Field) -> None:
        for size in sizes:
            self.operator.chebyshev_step(size, b, x)
