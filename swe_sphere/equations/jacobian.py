"""The derivative of the right-hand side at one state, as an operator; any number may be in use."""

from collections.abc import Callable, Sequence
from typing import Self

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.equations.discrete_scene import DiscreteScene
from swe_sphere.equations.right_hand_side import RightHandSide
from swe_sphere.kernels import combine_kernel

Tendency = Callable[[wp.array, float, wp.array], None]


class ExactJacobian:
    """The product by kernels of the derivatives of all terms."""

    def __init__(self, tangent: RightHandSide, base: wp.array | None) -> None:
        """base: where the tangent is taken; None: the same derivative at all states."""
        self._tangent, self._base, self._time = tangent, base, 0.0

    def update(self, state: wp.array, t: float) -> Self:
        """Take the derivative at a copy of the state and at time t [s]."""
        self._time = t
        if self._base is not None:
            wp.copy(self._base, state)
        return self

    def __call__(self, direction: wp.array, out: wp.array) -> None:
        """Write J direction to `out`, another array."""
        self._tangent(direction, self._time, out)


class DifferenceJacobian:
    """J d near [F(x + e d) - F(x)]/e with e = sqrt(round-off) max|x| / max|d|.

    Knoll & Keyes 2004 (doi:10.1016/j.jcp.2003.08.010), section 2.3, with each field measured by its
    own size (`_sizes_of`).  For comparison, and for effects without a derivative of
    their own: it costs about what the exact product does, but has only half the digits.
    """

    def __init__(self, model: DiscreteScene, names: Sequence[str], tendency: Tendency) -> None:
        """names: of the blocks (N,) of a state; tendency: (x, t, out)."""
        self._model, self._names, self._tendency = model, list(names), tendency
        real, size = model.device_mesh.real, len(names) * model.device_mesh.size
        self._one, self._two = combine_kernel(real, 1), combine_kernel(real, 2)
        self._base, self._slope, self._moved, self._zero = (model.zeros(size) for _ in range(4))
        self._root = float(np.sqrt(np.finfo(model.device_mesh.numpy_real).eps))
        self._time, self._sizes = 0.0, np.ones(len(names))
        model.launch.load(self._one, self._two)

    def update(self, state: wp.array, t: float) -> Self:
        """Take the derivative at a copy of the state and at time t [s]; costs a right-hand side."""
        wp.copy(self._base, state)
        self._time, self._sizes = t, self._sizes_of(state)
        self._tendency(state, t, self._slope)
        return self

    def __call__(self, direction: wp.array, out: wp.array) -> None:
        """Write J direction to `out`, another array; costs one right-hand side."""
        self._model.counters["tangent_evaluations"] += 1
        relative = float((self._largest(direction) / self._sizes).max())
        if relative == 0.0:
            out.zero_()
            return
        e, launch, size = self._root / relative, self._model.launch, self._base.size
        launch(self._one, size, self._base, direction, e, self._moved)
        self._tendency(self._moved, self._time, out)
        launch(self._two, size, self._zero, out, 1.0 / e, self._slope, -1.0 / e, out)

    def _largest(self, state: wp.array) -> Array:
        """Return the largest modulus of each field."""
        mine = np.abs(state.numpy()).reshape(len(self._names), -1).max(axis=1)
        return np.asarray(np.max(self._model.comm.tell_all(mine), axis=0), dtype=np.float64)

    def _sizes_of(self, state: wp.array) -> Array:
        """Return for each field the size that changes of it are compared with.

        For a wind that is also the speed of gravity waves: a fluid at rest has no wind.  For a
        tracer with no mass it is a mixing ratio of 1.
        """
        sizes = self._largest(state)
        names, gravity = self._names, self._model.scene.planet.gravity
        depth = sizes[names.index("h")] or 1.0
        sizes[sizes == 0.0] = depth
        if "u" in names:
            sizes[:2] = max(sizes[:2].max(), np.sqrt(gravity * depth))
        return sizes


Jacobian = ExactJacobian | DifferenceJacobian
"""`jacobian(d, out)`: out = J d, with J the derivative at the state of the last `update`.

A Jacobian holds a copy of that state, so that Jacobians at several states can be applied in turns;
`update` allocates nothing.  Products are counted as tangent_evaluations.
"""
