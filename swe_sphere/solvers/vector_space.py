"""The space the solvers work in: flat device vectors with a weighted inner product.

The weights make the solvers independent of units: with the weights of the energy, a tolerance means
the same on every planet.  Vectors are Warp arrays (n,), stacks of them Warp arrays (m, n).  All
sums run in float64, whatever the vectors hold, in a fixed order.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from swe_sphere.errors import ConfigError
from swe_sphere.operators.work import Work
from swe_sphere.solvers.device_space import DeviceVectors
from swe_sphere.solvers.host_space import HostVectors

__all__ = ["VectorSpace"]

Array = NDArray[np.float64]


class _Counted:
    """The operations of a space, counted."""

    def __init__(self, do: HostVectors | DeviceVectors, work: Work, kind: str) -> None:
        def counted(name: str, rows: Callable[..., int] | None = None) -> Callable[..., Any]:
            return work.counted(f"{name} {kind}", getattr(do, name), rows)

        self.copy, self.clear, self.scale = counted("copy"), counted("clear"), counted("scale")
        self.axpby, self.dot = counted("axpby"), counted("dot")
        self.project = counted("project", lambda stack, count, v: count)
        self.combine_rows = counted("combine_rows", lambda scale, x, stack, c, out: len(c))


class VectorSpace:
    """Vectors of n numbers with <a, b> = sum_i w_i a_i b_i and |a| = sqrt(<a, a>)."""

    def __init__(
        self,
        weights: ArrayLike,
        device: str = "cpu",
        real: type = wp.float64,
        kernels: bool | None = None,
        work: Work | None = None,
    ) -> None:
        """Weights (n,) > 0 [any unit]; real: wp.float64 or wp.float32, the type of the vectors.

        kernels: use Warp kernels rather than BLAS; the default is to do so except on "cpu".
        work: counts the operations.
        Raises ConfigError unless all weights are positive and finite.
        """
        values = np.array(weights, dtype=np.float64)
        if values.ndim != 1 or not np.all((values > 0.0) & np.isfinite(values)):
            raise ConfigError("the weights of a vector space must be positive and finite")
        self.n, self.device, self.real = values.size, str(wp.get_device(device)), real
        self.epsilon = float(np.finfo(wp.dtype_to_numpy(real)).eps)
        by_kernels = self.device != "cpu" if kernels is None else kernels
        self._do: HostVectors | DeviceVectors | _Counted = (
            DeviceVectors(values, real, self.device) if by_kernels else HostVectors(values, real)
        )
        if work is not None:
            self._do = _Counted(self._do, work, f"{np.dtype(wp.dtype_to_numpy(real))} {self.n}")

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

    def copy(self, source: wp.array, target: wp.array) -> None:
        """target = source."""
        self._do.copy(source, target)

    def clear(self, x: wp.array) -> None:
        """x = 0."""
        self._do.clear(x)

    def scale(self, a: float, x: wp.array) -> None:
        """x = a x."""
        self._do.scale(a, x)

    def axpy(self, a: float, x: wp.array, y: wp.array) -> None:
        """y = y + a x."""
        self._do.axpby(a, x, 1.0, y)

    def axpby(self, a: float, x: wp.array, b: float, y: wp.array) -> None:
        """y = a x + b y."""
        self._do.axpby(a, x, b, y)

    def dot(self, a: wp.array, b: wp.array) -> float:
        """<a, b>."""
        return self._do.dot(a, b)

    def norm(self, a: wp.array) -> float:
        """|a|; NaN when an element is."""
        return math.sqrt(self._do.dot(a, a))

    def project(self, stack: wp.array, count: int, v: wp.array) -> Array:
        """<stack[s], v> for s < count, as numpy array (count,) that the next call overwrites."""
        return self._do.project(stack, count, v)

    def combine(
        self,
        x: wp.array,
        stack: wp.array,
        coefficients: ArrayLike,
        out: wp.array,
        scale: float = 1.0,
    ) -> None:
        """out = scale (x + sum_s c_s stack[s]) over the first len(c) rows; `out` may be `x`."""
        c = np.asarray(coefficients, dtype=np.float64)
        self._do.combine_rows(scale, x, stack, c, out)
