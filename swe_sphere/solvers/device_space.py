"""Vector arithmetic by Warp kernels: for GPUs, and on "cpu" to test it."""

from typing import Any

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.kernels.vectors import (
    axpby_kernel,
    combine_rows_kernel,
    least_kernel,
    products_kernel,
)

# Sums are cut in this many blocks, added up on the host in a fixed order.
BLOCKS = 64
BLOCK_THREADS = 256


class DeviceVectors:
    """The operations of `VectorSpace` on any Warp device; see there for their meaning."""

    def __init__(self, weights: Array, real: type, device: str) -> None:
        self.real, self.device, self.n = real, wp.get_device(device), weights.size
        self._weights = wp.array(weights, dtype=wp.float64, device=self.device)
        self._span = -(-self.n // BLOCKS)
        self._combine, self._axpby = combine_rows_kernel(real), axpby_kernel(real)
        self._sum, self._least = products_kernel(real), least_kernel(real)
        self._reserve(32)

    def _reserve(self, rows: int) -> None:
        """Room for the coefficients and partial sums of so many rows."""
        self._rows = rows
        self._partial = wp.zeros((rows, BLOCKS), dtype=wp.float64, device=self.device)
        self._partial_host = wp.zeros((rows, BLOCKS), dtype=wp.float64, device="cpu")
        self._coefficients = wp.zeros(rows, dtype=wp.float64, device=self.device)
        # Pageable memory: a copy to the device has left it when wp.copy returns.
        self._coefficients_host = wp.zeros(rows, dtype=wp.float64, device="cpu")
        self._sums, self._staged = self._partial_host.numpy(), self._coefficients_host.numpy()
        self._products = np.empty(rows)

    def copy(self, source: wp.array, target: wp.array) -> None:
        wp.copy(target, source)

    def clear(self, x: wp.array) -> None:
        x.zero_()

    def axpby(self, a: float, x: wp.array, b: float, y: wp.array) -> None:
        wp.launch(self._axpby, self.n, inputs=[a, x, b, y], device=self.device)

    def scale(self, a: float, x: wp.array) -> None:
        self.axpby(a, x, 0.0, x)

    def dots(self, *pairs: tuple[wp.array, wp.array]) -> Array:
        return np.array([float(self.project(a.reshape((1, self.n)), 1, b)[0]) for a, b in pairs])

    def project(self, stack: wp.array, count: int, v: wp.array) -> Array:
        if count > self._rows:
            self._reserve(2 * count)
        self._reduce(self._sum, count, [stack, self._weights, v, self._span, self._partial])
        return np.sum(self._sums[:count], axis=1, out=self._products[:count])

    def lowest(self, x: wp.array, begin: int, end: int) -> float:
        span = -(-(end - begin) // BLOCKS)
        self._reduce(self._least, 1, [x, begin, end, span, self._partial])
        return float(self._sums[0].min())

    def _reduce(self, kernel: wp.Kernel, rows: int, inputs: list[Any]) -> None:
        """Bring what each block makes of the rows to the host."""
        wp.launch_tiled(
            kernel, dim=(rows, BLOCKS), inputs=inputs, block_dim=BLOCK_THREADS, device=self.device
        )
        wp.copy(self._partial_host, self._partial, count=rows * BLOCKS)
        wp.synchronize_device(self.device)

    def combine_rows(
        self, scale: float, x: wp.array, stack: wp.array, coefficients: Array, out: wp.array
    ) -> None:
        count = len(coefficients)
        if count > self._rows:
            self._reserve(2 * count)
        self._staged[:count] = coefficients
        wp.copy(self._coefficients, self._coefficients_host, count=max(count, 1))
        inputs = [scale, x, stack, self._coefficients, count, out]
        wp.launch(self._combine, self.n, inputs=inputs, device=self.device)
