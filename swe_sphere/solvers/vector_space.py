"""The space the solvers work in: flat device vectors with a weighted inner product.

The weights make the solvers independent of units: with the weights of the energy, a tolerance means
the same on every planet.  Vectors are Warp arrays (n,), stacks of them Warp arrays (m, n).  All
sums run in float64, whatever the vectors hold, in a fixed order.
"""

import math
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from swe_sphere.errors import ConfigError
from swe_sphere.operators import DeviceMesh
from swe_sphere.solvers.vector_operations import DeviceVectors, HostVectors


class VectorSpace:
    """Vectors of n numbers with <a, b> = sum_i w_i a_i b_i and |a| = sqrt(<a, a>).

    Operations of the device, or of the host for device "cpu":

    - copy(source, target): target = source; clear(x): x = 0; scale(a, x): x = a x;
    - axpby(a, x, b, y): y = a x + b y; combine_rows(scale, x, stack, c, out): see `combine`;
    - dots((a, b), (c, d), ...): <a, b>, <c, d>, ... as a numpy array;
    - project(stack, count, v): <stack[s], v> for s < count as a numpy array (count,);
    - projections((stack, count, v), ...): the results of `project`, one behind the other;
    - lowest(x, begin, end): the least of x[begin:end], -infinity where one of them is NaN.

    The next product overwrites the array that a product has returned.  Ranks exchange one message
    for all products of a call.
    """

    def __init__(
        self,
        weights: ArrayLike,
        device: str | None = None,
        real: type | None = None,
        kernels: bool | None = None,
        mesh: DeviceMesh | None = None,
    ) -> None:
        """Weights (n,) > 0 [any unit]; real: wp.float64 or wp.float32, the type of the vectors.

        mesh: whose nodal fields (k N,) the weights are; several ranks may share them.  Device and
        type are its own, unless others are given; without it the CPU and wp.float64.
        kernels: those of GPUs; the default is to use them except on "cpu".
        Raises ConfigError unless all weights are positive and finite.
        """
        self._mesh = mesh
        values = np.array(weights, dtype=np.float64)
        self.whole = values.size
        """Numbers of a vector on all ranks together."""
        values = values if mesh is None else mesh.restrict(values)
        if values.ndim != 1 or not np.all((values > 0.0) & np.isfinite(values)):
            raise ConfigError("the weights of a vector space must be positive and finite")
        device = device or ("cpu" if mesh is None else mesh.device)
        real = real or (wp.float64 if mesh is None else mesh.real)
        self.n, self.device, self.real = values.size, str(wp.get_device(device)), real
        self.epsilon = float(np.finfo(wp.dtype_to_numpy(real)).eps)
        do: HostVectors | DeviceVectors
        if (self.device != "cpu") if kernels is None else kernels:
            do = DeviceVectors(values, real, self.device, mesh)
        else:
            do = HostVectors(values, real, mesh)
        self.copy, self.clear, self.scale, self.axpby = do.copy, do.clear, do.scale, do.axpby
        self.dots, self.project, self.projections = do.dots, do.project, do.projections
        self.lowest, self.combine_rows = do.lowest, do.combine_rows

    def zeros(self) -> wp.array:
        """A new vector (n,) of zeros."""
        return wp.zeros(self.n, dtype=self.real, device=self.device)

    def stack(self, rows: int) -> wp.array:
        """A new stack (rows, n) of zeros."""
        return wp.zeros((rows, self.n), dtype=self.real, device=self.device)

    def room(self, rows: int) -> wp.array:
        """A new stack (rows, n) of whatever was there.

        In the memory of a CPU a row takes its place only when it is first written to: room for many
        costs nothing until they are needed.
        """
        return wp.empty((rows, self.n), dtype=self.real, device=self.device)

    def saved(self, x: wp.array) -> NDArray[Any]:
        """A copy of a vector on the host, of the whole mesh (k N,) where ranks share it."""
        values: NDArray[Any] = x.numpy() if self._mesh is None else self._mesh.collect(x)
        return values.copy()

    def load(self, values: NDArray[Any], x: wp.array) -> None:
        """x = what `saved` returned."""
        x.assign(values if self._mesh is None else self._mesh.restrict(values))

    def axpy(self, a: float, x: wp.array, y: wp.array) -> None:
        """y = y + a x."""
        self.axpby(a, x, 1.0, y)

    def dot(self, a: wp.array, b: wp.array) -> float:
        """<a, b>."""
        return float(self.dots((a, b))[0])

    def norm(self, a: wp.array) -> float:
        """|a|; NaN when an element is."""
        return math.sqrt(self.dot(a, a))

    def match_mean(
        self, source: wp.array, x: wp.array, unit: wp.array, square: float = 1.0, gain: float = 0.0
    ) -> None:
        """Add a multiple of `unit` to x, so that <x, unit> = <source, unit> + gain |unit|^2.

        square: |unit|^2.
        """
        there, here = self.dots((source, unit), (x, unit))
        self.axpy(float(there - here) / square + gain, unit, x)

    def combine(
        self, x: wp.array, stack: wp.array, coefficients: ArrayLike, out: wp.array,
        scale: float = 1.0,
    ) -> None:  # fmt: skip
        """out = scale (x + sum_s c_s stack[s]) over the first len(c) rows; `out` may be `x`."""
        c = np.asarray(coefficients, dtype=np.float64)
        self.combine_rows(scale, x, stack, c, out)
