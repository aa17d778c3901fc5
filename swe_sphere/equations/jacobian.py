"""Operators that apply the derivative of the right-hand side at a state to directions."""

from collections.abc import Callable, Sequence
from typing import Self

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.equations.discrete_scene import DiscreteScene
from swe_sphere.equations.right_hand_side import RightHandSide

Tendency = Callable[[wp.array, float, wp.array], None]


class ExactJacobian:
    """Jacobian whose kernels apply the derivatives of all terms."""

    def __init__(self, tangent: RightHandSide, base: wp.array | None) -> None:
        """Store the "tangent" and its array `base`; None if all states have the same derivative."""
        self._tangent, self._base, self._time = tangent, base, 0.0

    def update(self, state: wp.array, t: float) -> Self:
        """Linearise at a copy of the state and at time t [s]."""
        self._time = t
        if self._base is not None:
            wp.copy(self._base, state)
        return self

    def __call__(self, direction: wp.array, out: wp.array) -> None:
        """Write J times the direction to `out`, which must be another array."""
        self._tangent(direction, self._time, out)


class DifferenceJacobian:
    """J d approximated by [F(x + e d) - F(x)]/e with e = sqrt(round-off) max|x| / max|d|.

    Knoll & Keyes 2004 (doi:10.1016/j.jcp.2003.08.010), section 2.3, with a separate scale for each
    field (`_sizes_of`). The approximation serves for comparison, and for effects without a
    derivative. It costs about as much as the exact product, but has only half the digits.
    """

    def __init__(self, model: DiscreteScene, names: Sequence[str], tendency: Tendency) -> None:
        """Store the names of the blocks (N,) of a state, and the function tendency(x, t, out)."""
        self._model, self._names, self._tendency = model, list(names), tendency
        size = len(names) * model.device_mesh.size
        self._base, self._slope, self._moved, self._zero = (model.zeros(size) for _ in range(4))
        self._root = float(np.sqrt(np.finfo(model.device_mesh.numpy_real).eps))
        self._time, self._sizes = 0.0, np.ones(len(names))

    def update(self, state: wp.array, t: float) -> Self:
        """Linearise at a copy of the state and at time t [s]; costs one right-hand side."""
        wp.copy(self._base, state)
        self._time, self._sizes = t, self._sizes_of(state)
        self._tendency(state, t, self._slope)
        return self

    def __call__(self, direction: wp.array, out: wp.array) -> None:
        """Write J times the direction to `out`, another array; costs one right-hand side."""
        self._model.counters["tangent_evaluations"] += 1
        if (relative := float((self._largest(direction) / self._sizes).max())) == 0.0:
            out.zero_()
            return
        e, combine = self._root / relative, self._model.launch.combine
        combine(self._base, direction, e, out=self._moved)
        self._tendency(self._moved, self._time, out)
        combine(self._zero, out, 1.0 / e, self._slope, -1.0 / e, out=out)

    def _largest(self, state: wp.array) -> Array:
        """Return the largest modulus of each field."""
        mine = np.abs(state.numpy()).reshape(len(self._names), -1).max(axis=1)
        return np.asarray(np.max(self._model.comm.allgather(mine), axis=0), dtype=np.float64)

    def _sizes_of(self, state: wp.array) -> Array:
        """Return for each field the scale of its changes.

        The scale of a wind is at least the speed of gravity waves, because a fluid at rest has no
        wind. The scale of a tracer without mass corresponds to a mixing ratio of 1.
        """
        sizes = self._largest(state)
        names, gravity = self._names, self._model.scene.planet.gravity
        depth = sizes[names.index("h")] or 1.0
        if "u" in names:
            sizes[:2] = max(sizes[:2].max(), np.sqrt(gravity * depth))
        sizes[sizes == 0.0] = depth
        return sizes


Jacobian = ExactJacobian | DifferenceJacobian
"""Operator `jacobian(d, out)`: out = J d, with J the derivative at the state of the last `update`.

A Jacobian contains a copy of that state, so that Jacobians at several states can be applied in
turns. `update` allocates nothing. The counter "tangent_evaluations" counts products.
"""
