"""The derivative of the right-hand side at one state, as an operator; any number may be in use."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Self

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.equations.discrete_scene import DiscreteScene, PrescribedFields
from swe_sphere.equations.tendencies import TendencyComponent
from swe_sphere.equations.tracer_equations import TracerEquations
from swe_sphere.kernels import combine_kernel


class Jacobian(ABC):
    """`jacobian(d, out)`: out = J d, with J the derivative at the state of the last `update`.

    It holds that state itself, so that those at several states can be applied in turns.
    """

    def __init__(self, counters: dict[str, int]) -> None:
        """counters: where products are counted, as tangent_evaluations."""
        self._counters = counters

    @abstractmethod
    def update(self, state: wp.array, t: float) -> Self:
        """Take the derivative at a copy of the state and at time t [s]; allocates nothing."""

    def __call__(self, direction: wp.array, out: wp.array) -> None:
        """out = J direction, in another array."""
        self._counters["tangent_evaluations"] += 1
        self._apply(direction, out)

    @abstractmethod
    def _apply(self, direction: wp.array, out: wp.array) -> None: ...


class ExactJacobian(Jacobian):
    """The product by kernels of the derivatives of all terms."""

    def __init__(
        self,
        discrete: DiscreteScene,
        tangent: TendencyComponent,
        tracers: TracerEquations | None,
        wind: PrescribedFields,
        counters: dict[str, int],
    ) -> None:
        super().__init__(counters)
        needed = tangent.needs_base or tracers is not None
        self._base = discrete.zeros() if needed else None
        self._fluid = tangent.at(self._base) if tangent.needs_base else tangent
        self._tracers, self._wind, self._time = tracers, wind, 0.0

    def update(self, state: wp.array, t: float) -> Self:
        """Take the derivative there."""
        self._time = t
        if self._base is not None:
            wp.copy(self._base, state)
        return self

    def _apply(self, direction: wp.array, out: wp.array) -> None:
        self._wind.set_time(self._time)
        self._fluid(direction, out)
        if self._tracers is not None:
            self._tracers.tangent(self._base, direction, out)


class DifferenceJacobian(Jacobian):
    """J d near [F(x + e d) - F(x)]/e with e = sqrt(round-off) max|x| / max|d|.

    Knoll & Keyes 2004 (doi:10.1016/j.jcp.2003.08.010), section 2.3, with each field measured by its
    own size (`_sizes_of`).  For comparison, and for effects without a derivative of
    their own: it costs about what the exact product does, but has only half the digits.
    """

    def __init__(
        self,
        discrete: DiscreteScene,
        tendency: Callable[[wp.array, float, wp.array], None],
        counters: dict[str, int],
    ) -> None:
        super().__init__(counters)
        real, launch = discrete.device_mesh.real, discrete.launch
        self._blocks, self._launch, self._tendency = discrete.names, launch, tendency
        self._one, self._two = combine_kernel(real, 1), combine_kernel(real, 2)
        self._base, self._slope, self._moved, self._zero = (discrete.zeros() for _ in range(4))
        self._root = float(np.sqrt(np.finfo(discrete.device_mesh.numpy_real).eps))
        self._comm = discrete.device_mesh.comm
        self._time, self._sizes = 0.0, np.ones(len(self._blocks))
        self._gravity = discrete.scene.planet.gravity
        launch.load(self._one, self._two)

    def update(self, state: wp.array, t: float) -> Self:
        """Take the derivative there; costs one right-hand side."""
        wp.copy(self._base, state)
        self._time, self._sizes = t, self._sizes_of(state)
        self._tendency(state, t, self._slope)
        return self

    def _apply(self, direction: wp.array, out: wp.array) -> None:
        """Costs one right-hand side."""
        relative = float((self._largest(direction) / self._sizes).max())
        if relative == 0.0:
            out.zero_()
            return
        e, launch, size = self._root / relative, self._launch, self._base.size
        launch(self._one, size, self._base, direction, e, self._moved)
        self._tendency(self._moved, self._time, out)
        launch(self._two, size, self._zero, out, 1.0 / e, self._slope, -1.0 / e, out)

    def _largest(self, state: wp.array) -> Array:
        """Largest modulus of each field."""
        mine = np.abs(state.numpy()).reshape(len(self._blocks), -1).max(axis=1)
        return np.asarray(np.max(self._comm.tell_all(mine), axis=0), dtype=np.float64)

    def _sizes_of(self, state: wp.array) -> Array:
        """What a change of each field is small against.

        A wind, to the speed of gravity waves too: by that of a fluid at rest no depth would change.
        A tracer of which there is none, to a mixing ratio of 1.
        """
        sizes = self._largest(state)
        depth = sizes[self._blocks.index("h")] or 1.0
        sizes[sizes == 0.0] = depth
        if "u" in self._blocks:
            sizes[:2] = max(sizes[:2].max(), np.sqrt(self._gravity * depth))
        return sizes
