"""Vector arithmetic on the memory of Warp arrays: on the CPU, and by Warp kernels.

On the CPU nothing is copied: products by kernels in C++, each in an order that does not depend on
how many ranks share the vectors; what numpy would take several passes for by kernels as well; the
rest by numpy.  No BLAS is called: it has threads that spin, and an order of its own.  The kernels
of `DeviceVectors` are for GPUs, and run on "cpu" to be tested.
"""

import ctypes
import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.kernels.simd.sums import (
    SPAN,
    combinations_kernel,
    scaled_sum_kernel,
    weighted_products_kernel,
)
from swe_sphere.kernels.vectors import (
    axpby_kernel,
    combine_rows_kernel,
    least_kernel,
    products_kernel,
)
from swe_sphere.operators import DeviceMesh
from swe_sphere.operators.chunks import equal_spans
from swe_sphere.operators.launch import Launcher
from swe_sphere.ranks.communicator import Communicator

Floats = NDArray[np.floating]

MOST_VIEWS = 512


class _Summed:
    """Vectors whose products are sums over spans of `length` numbers, or over chunks of ranks."""

    projections: Callable[..., Array]

    def __init__(
        self, weights: Array, real: type, device: str, mesh: DeviceMesh | None, length: int
    ) -> None:
        self.real, self.device, self.n = real, device, weights.size
        self._weights = wp.array(weights, dtype=wp.float64, device=device)
        self._comm, self._shared, self._size = Communicator(), None, self.n
        if mesh is not None and mesh.comm.shared:
            self._comm, self._shared, self._size = mesh.comm, mesh.chunks, mesh.size
            self._spans = mesh.chunks.spans
        else:
            self._spans = wp.array(equal_spans(self.n, length), dtype=wp.int32, device=device)

    def project(self, stack: wp.array, count: int, v: wp.array) -> Array:
        return self.projections((stack, count, v))

    def dots(self, *pairs: tuple[wp.array, wp.array]) -> Array:
        return self.projections(*((a.reshape((1, self.n)), 1, b) for a, b in pairs))

    def _least_of_all(self, lowest: float) -> float:
        """Return the least value that any rank has found; NaN counts as -infinity."""
        return float(self._comm.of_each(-math.inf if math.isnan(lowest) else lowest).min())


class HostVectors(_Summed):
    """The operations of `VectorSpace` on device "cpu"; see there for their meaning."""

    def __init__(self, weights: Array, real: type, mesh: DeviceMesh | None = None) -> None:
        super().__init__(weights, real, "cpu", mesh, SPAN)
        self.dtype = np.dtype(wp.dtype_to_numpy(real))
        self._views: dict[tuple[int, int, int], Floats] = {}
        self._call = wp.zeros(4, dtype=wp.uint64, device="cpu")
        self._arguments, self._listed = self._call.numpy(), np.empty(0, np.uint64)
        self._products, self._coefficients = np.empty(0), np.empty(0)

    @functools.cached_property
    def _sum_of_two(self) -> tuple[Any, Array]:
        """The command, and its two factors."""
        factors = wp.zeros(2, dtype=wp.float64, device="cpu")
        inputs = [self._call, factors, self.n]
        command = self._record(scaled_sum_kernel(self.real), -(-self.n // SPAN), inputs)
        return command, factors.numpy()

    def _prepare_products(self, calls: int) -> None:
        """Load the kernel, with room for so many stacks, each with a vector."""
        call = wp.zeros(3 + 3 * calls, dtype=wp.uint64, device="cpu")
        self._listed = call.numpy()
        inputs = [call, self._weights, self._spans, self._size]
        self._multiply = self._record(weighted_products_kernel(self.real), 1, inputs)

    def _prepare_combinations(self, rows: int) -> None:
        """Load the kernel, with room for the coefficients of so many rows."""
        coefficients = wp.zeros(1 + rows, dtype=wp.float64, device="cpu")
        self._coefficients = coefficients.numpy()
        inputs = [self._call, coefficients, self.n]
        self._add_up = self._record(combinations_kernel(self.real), -(-self.n // SPAN), inputs)

    def _record(self, kernel: wp.Kernel, threads: int, inputs: list[Any]) -> Any:
        Launcher("cpu", self._comm).load(kernel)
        return wp.launch(kernel, threads, inputs, device="cpu", record_cmd=True)

    def view(self, x: wp.array) -> Floats:
        """The memory of a Warp array as numpy array of the same shape.

        `wp.array.numpy` takes 3 us a call.  The views kept here own nothing: one is only ever used
        for a living array of the same address, size and dimensions.
        """
        view = self._views.get((x.ptr, x.size, x.ndim))
        return self._new_view(x) if view is None or x.dtype is not self.real else view

    def _new_view(self, x: wp.array) -> Floats:
        if x.dtype is not self.real or x.shape[-1] != self.n or not x.is_contiguous:
            raise TypeError(f"expected contiguous arrays (…, {self.n}) of {self.real.__name__}")
        if len(self._views) >= MOST_VIEWS:
            self._views.clear()
        memory = (ctypes.c_char * (x.size * self.dtype.itemsize)).from_address(x.ptr)
        view = np.frombuffer(memory, self.dtype).reshape(x.shape)
        self._views[x.ptr, x.size, x.ndim] = view
        return view

    def copy(self, source: wp.array, target: wp.array) -> None:
        np.copyto(self.view(target), self.view(source))

    def clear(self, x: wp.array) -> None:
        self.view(x).fill(0.0)

    def axpby(self, a: float, x: wp.array, b: float, y: wp.array) -> None:
        self._arguments[:2] = self._address(x), self._address(y)
        command, factors = self._sum_of_two
        factors[:] = a, b
        command.launch()

    def scale(self, a: float, x: wp.array) -> None:
        target = self.view(x)
        np.multiply(target, self.dtype.type(a), out=target)

    def dots(self, *pairs: tuple[wp.array, wp.array]) -> Array:
        return self.projections(*((a, 1, b) for a, b in pairs))

    def projections(self, *calls: tuple[wp.array, int, wp.array]) -> Array:
        count = sum(rows for _, rows, _ in calls)
        if count > self._products.size:
            self._products = np.empty(max(2 * count, 16))
        room = self._products if self._shared is None else self._shared.room(count)
        arguments = [room.ctypes.data, 0 if self._shared is None else count, len(calls)]
        for stack, rows, v in calls:
            arguments += self._address(stack), self._address(v), rows
        if len(arguments) > self._listed.size:
            self._prepare_products(max(len(calls), 8))
        self._listed[: len(arguments)] = arguments
        self._multiply.launch()
        return self._products[:count] if self._shared is None else self._shared.total(count)

    def lowest(self, x: wp.array, begin: int, end: int) -> float:
        return self._least_of_all(float(self.view(x)[begin:end].min()))

    def combine_rows(
        self, scale: float, x: wp.array, stack: wp.array, coefficients: Array, out: wp.array
    ) -> None:
        count = len(coefficients)
        if count >= self._coefficients.size:
            self._prepare_combinations(max(2 * count, 16))
        self._coefficients[0], self._coefficients[1 : 1 + count] = scale, coefficients
        self._arguments[:4] = *map(self._address, (x, stack, out)), count
        self._add_up.launch()

    def _address(self, x: wp.array) -> int:
        self.view(x)  # which refuses what it is not made for
        address: int = x.ptr
        return address


BLOCKS = 64
"""So many pieces the sums of a process alone are cut in."""
BLOCK_THREADS = 256


class DeviceVectors(_Summed):
    """The operations of `VectorSpace` on any Warp device; see there for their meaning."""

    def __init__(
        self, weights: Array, real: type, device: str, mesh: DeviceMesh | None = None
    ) -> None:
        super().__init__(weights, real, device, mesh, -(-weights.size // BLOCKS))
        self._blocks = self._spans.shape[1]
        self._combine, self._axpby = combine_rows_kernel(real), axpby_kernel(real)
        self._sum, self._least = products_kernel(real), least_kernel(real)
        self._reserve(32)

    def _reserve(self, rows: int) -> None:
        """Room for the coefficients and partial sums of so many rows."""
        self._rows = rows
        shape = rows, self._blocks
        self._partial = wp.zeros(shape, dtype=wp.float64, device=self.device)
        pinned = wp.get_device(self.device).is_cuda
        self._partial_host = wp.zeros(shape, dtype=wp.float64, device="cpu", pinned=pinned)
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

    def projections(self, *calls: tuple[wp.array, int, wp.array]) -> Array:
        count = sum(rows for _, rows, _ in calls)
        if count > self._rows:
            self._reserve(2 * count)
        row = 0
        for stack, rows, v in calls:
            partial = self._partial[row : row + rows]
            inputs = [stack, self._weights, v, self._spans, self._size, partial]
            self._reduce(self._sum, rows, inputs)
            row += rows
        self._fetch(count)
        if self._shared is None:
            return np.sum(self._sums[:count], axis=1, out=self._products[:count])
        self._shared.room(count)[:] = self._sums[:count].T
        return self._shared.total(count)

    def lowest(self, x: wp.array, begin: int, end: int) -> float:
        span = -(-(end - begin) // self._blocks)
        self._reduce(self._least, 1, [x, begin, end, span, self._partial])
        self._fetch(1)
        return self._least_of_all(float(self._sums[0].min()))

    def _reduce(self, kernel: wp.Kernel, rows: int, inputs: list[Any]) -> None:
        wp.launch_tiled(
            kernel,
            dim=(rows, self._blocks),
            inputs=inputs,
            block_dim=BLOCK_THREADS,
            device=self.device,
        )

    def _fetch(self, rows: int) -> None:
        """Bring what each block has made of the rows to the host."""
        wp.copy(self._partial_host, self._partial, count=rows * self._blocks)
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
