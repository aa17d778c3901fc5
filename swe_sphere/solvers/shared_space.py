"""Vector arithmetic on the CPUs of several ranks: the same bits, whatever their number.

Products are summed up chunk by chunk of the mesh; what BLAS does depends on where a number stands.
"""

from typing import Any

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.kernels.vectors import chunk_products_kernel
from swe_sphere.operators import DeviceMesh
from swe_sphere.solvers.host_space import QUIETLY, HostVectors


class SharedVectors(HostVectors):
    """The operations of `VectorSpace` on vectors of nodal fields; see there for their meaning."""

    def __init__(self, weights: Array, real: Any, mesh: DeviceMesh) -> None:
        super().__init__(weights, real)
        self._mesh, self._chunks = mesh, mesh.chunks
        self._device_weights = wp.array(weights, dtype=wp.float64, device="cpu")
        self._kernel, self._total = chunk_products_kernel(real), np.empty(self.n, self.dtype)
        self._partial = wp.zeros((self._chunks.count, 32), dtype=wp.float64, device="cpu")

    def dot(self, a: wp.array, b: wp.array) -> float:
        return float(self.project(a.reshape((1, self.n)), 1, b)[0])

    def project(self, stack: wp.array, count: int, v: wp.array) -> Array:
        if count > self._partial.shape[1]:
            shape = (self._chunks.count, 2 * count)
            self._partial = wp.zeros(shape, dtype=wp.float64, device="cpu")
        inputs = [
            stack, self._device_weights, v, self._chunks.starts, count, self._mesh.size,
            self._partial,
        ]  # fmt: skip
        wp.launch(self._kernel, self._chunks.count, inputs=inputs, device="cpu")
        everything = self._chunks.of_all(self._partial.numpy()[:, :count])
        with QUIETLY():
            return np.sum(everything, axis=0, out=self._room(count))

    def lowest(self, x: wp.array, begin: int, end: int) -> float:
        return min(self._mesh.comm.tell_all(super().lowest(x, begin, end)))

    def combine_rows(
        self, scale: float, x: wp.array, stack: wp.array, coefficients: Array, out: wp.array
    ) -> None:
        total, target = self._total, self.view(out)
        total.fill(0.0)
        with QUIETLY():
            for row, factor in zip(self.view(stack), coefficients.astype(self.dtype), strict=False):
                np.add(total, np.multiply(row, factor, out=self._sum), out=total)
            np.add(self.view(x), total, out=target)
            if scale != 1.0:
                np.multiply(target, self.dtype.type(scale), out=target)
