"""Flat device vectors with a weighted inner product, in which the solvers work.

The weights make the solvers independent of units: with the weights of the energy, a tolerance has
the same meaning on every planet. Vectors are Warp arrays (n,), stacks of them Warp arrays (m, n).
All sums run in float64, in the same order on any number of ranks under MPI.
"""

import ctypes
import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.kernels.simd.sums import SPAN, combinations, scaled_sum, weighted_products
from swe_sphere.kernels.vectors import axpby, combine_rows, least, products
from swe_sphere.operators import DeviceMesh
from swe_sphere.operators.chunks import equal_spans
from swe_sphere.operators.launch import Launcher

MOST_VIEWS = 512
"""Largest number of stored views of arrays."""
BLOCKS = 64
"""Number of blocks of a single process's sums on a GPU."""
BLOCK_THREADS = 256
"""Number of threads of a block that computes a sum on a GPU."""


class VectorSpace:
    """Vectors of n numbers with <a, b> = sum_i w_i a_i b_i and |a| = sqrt(<a, a>).

    A new space is a `HostSpace` on device "cpu" and a `DeviceSpace` elsewhere. The next product
    overwrites the array that a product has returned. Ranks exchange one message in each product.
    """

    copy: Callable[[wp.array, wp.array], None]
    """Function copy(source, target) that sets target = source; the source may be of any type."""
    clear: Callable[[wp.array], None]
    """Function clear(x) that sets x = 0."""
    scale: Callable[[float, wp.array], None]
    """Function scale(a, x) that sets x = a x."""
    axpby: Callable[..., None]
    """Function axpby(a, x, b, y, out=y) that sets out = a x + b y."""
    combine: Callable[..., None]
    """Function combine(x, stack, c, out, scale=1.0): out = scale (x + sum_s c_s stack[s]) over the
    first len(c) rows; `out` may be `x`."""
    projections: Callable[..., Array]
    """Function projections((stack, count, v), ...): <stack[s], v> for s < count of each triple."""
    lowest: Callable[[wp.array, int, int], float]
    """Function lowest(x, begin, end): the least of x[begin:end], -infinity if one is NaN."""
    _allocate: Callable[[], None]

    def __new__(
        cls, _: Any, device: Any = None, real: Any = None, mesh: Any = None
    ) -> "VectorSpace":
        if cls is not VectorSpace:
            return super().__new__(cls)
        device = device or ("cpu" if mesh is None else mesh.device)
        return super().__new__(HostSpace if wp.get_device(device).is_cpu else DeviceSpace)

    def __init__(
        self, weights: ArrayLike, device: str | None = None, real: type | None = None,
        mesh: DeviceMesh | None = None,
    ) -> None:  # fmt: skip
        """Create a space with weights (n,) > 0 [any unit] and vectors of `real`.

        real: wp.float64 or wp.float32. mesh: mesh of the weights' nodal fields (k N,), which
        several ranks may share. Device and type default to the mesh's, without a mesh to the CPU
        and wp.float64. Raises ConfigError unless all weights are positive and finite.
        """
        values = np.array(weights, dtype=np.float64)
        self.global_size = values.size
        """Numbers of a vector on all ranks together."""
        values = values if mesh is None else mesh.on_rank(values)
        if values.ndim != 1 or not np.all((values > 0.0) & np.isfinite(values)):
            raise ConfigError("the weights of a vector space must be positive and finite")
        self.n, self.real = values.size, real or (wp.float64 if mesh is None else mesh.real)
        device = device or ("cpu" if mesh is None else mesh.device)
        self.device, dtype = str(wp.get_device(device)), wp.dtype_to_numpy(self.real)
        self.dtype, self.epsilon = np.dtype(dtype), float(np.finfo(dtype).eps)
        self._weights = wp.array(values, dtype=wp.float64, device=self.device)
        self._launch = Launcher(self.device) if mesh is None else mesh.launch
        self._comm, self._shared, self._size = self._launch.comm, None, self.n
        if mesh is not None and mesh.comm.shared:
            self._shared, self._size = mesh.chunks, mesh.size
            self._spans = mesh.chunks.spans
        else:
            length = SPAN if isinstance(self, HostSpace) else -(-self.n // BLOCKS)
            self._spans = wp.array(equal_spans(self.n, length), dtype=wp.int32, device=self.device)
        self._allocate()

    def zeros(self) -> wp.array:
        """Return a new vector (n,) of zeros."""
        return wp.zeros(self.n, dtype=self.real, device=self.device)

    def stack(self, rows: int) -> wp.array:
        """Return a new stack (rows, n) of zeros."""
        return wp.zeros((rows, self.n), dtype=self.real, device=self.device)

    def empty_stack(self, rows: int) -> wp.array:
        """Return a new stack (rows, n) that is not initialised.

        In the memory of a CPU a row occupies memory only once it is written.
        """
        return wp.empty((rows, self.n), dtype=self.real, device=self.device)

    def converted(self, x: wp.array) -> wp.array:
        """Return x if it has the number type of the space, else a copy until the next call."""
        if x.dtype is not self.real:
            self.copy(x, self._converted)
        return x if x.dtype is self.real else self._converted

    @functools.cached_property
    def _converted(self) -> wp.array:
        return self.zeros()

    def axpy(self, a: float, x: wp.array, y: wp.array) -> None:
        """Set y = y + a x."""
        self.axpby(a, x, 1.0, y)

    def dots(self, *pairs: tuple[wp.array, wp.array]) -> Array:
        """Return <a, b> for each pair (a, b)."""
        return self.projections(*((a, 1, b) for a, b in pairs))

    def dot(self, a: wp.array, b: wp.array) -> float:
        """Return <a, b>."""
        return float(self.dots((a, b))[0])

    def norm(self, a: wp.array) -> float:
        """Return |a|, which is NaN if an element is."""
        return math.sqrt(self.dot(a, a))

    def match_mean(self, source: wp.array, x: wp.array, unit: wp.array, gain: float = 0.0) -> None:
        """Add a multiple of `unit`, a vector with |unit| = 1, to x.

        Then <x, unit> = <source, unit> + gain.
        """
        there, here = self.dots((source, unit), (x, unit))
        self.axpy(float(there - here) + gain, unit, x)

    def _least_of_all(self, lowest: float) -> float:
        """Return the least value of all ranks; NaN counts as -infinity."""
        return float(self._comm.allgather_number(-math.inf if math.isnan(lowest) else lowest).min())


class Masses:
    """Means over the sphere of the blocks (N,) of states, which corrections restore."""

    def __init__(self, mesh: DeviceMesh) -> None:
        self._space = VectorSpace(mesh.mesh.area / mesh.mesh.area.sum(), mesh=mesh)
        self._ones = mesh.upload(np.ones(mesh.size))

    def restore(self, source: wp.array, x: wp.array, block: int, gain: float = 0.0) -> None:
        """Shift a block of x to the mean of that block of `source`, plus `gain`."""
        part = slice(block * self._ones.size, (block + 1) * self._ones.size)
        self._space.match_mean(source[part], x[part], self._ones, gain)


class HostSpace(VectorSpace):
    """Vectors in the memory of the CPU, where nothing is copied.

    C++ kernels compute products, and combinations that numpy needs several passes for; numpy does
    the rest. No BLAS is called: its threads spin, and its order of summation varies.
    """

    def _allocate(self) -> None:
        self._views: dict[tuple[int, int, int], NDArray[Any]] = {}
        self._call = wp.zeros(4, dtype=wp.uint64, device="cpu")
        self._arguments, self._listed = self._call.numpy(), np.empty(0, np.uint64)
        self._products, self._coefficients = np.empty(0), np.empty(0)

    def _record(self, template: Any, threads: int, inputs: list[Any]) -> Any:
        (kernel,) = self._launch.compile(self.real, template)
        return wp.launch(kernel, threads, inputs, device="cpu", record_cmd=True)

    @functools.cached_property
    def _sum_of_two(self) -> tuple[Any, Array]:
        """Recorded command for the sum of two vectors, and its two factors."""
        factors = wp.zeros(2, dtype=wp.float64, device="cpu")
        command = self._record(scaled_sum, -(-self.n // SPAN), [self._call, factors, self.n])
        return command, factors.numpy()

    def view(self, x: wp.array) -> NDArray[Any]:
        """Return the memory of a Warp array as a numpy array of the same shape.

        `wp.array.numpy` takes 3 us per call. The views stored here own nothing: a view is only used
        for a living array of the same address, size and dimensions.
        """
        view = self._views.get((x.ptr, x.size, x.ndim))
        if view is not None and x.dtype is self.real:
            return view
        if x.dtype is not self.real or x.shape[-1] != self.n or not x.is_contiguous:
            raise TypeError(f"expected contiguous arrays (…, {self.n}) of {self.real.__name__}")
        if len(self._views) >= MOST_VIEWS:
            self._views.clear()
        memory = (ctypes.c_char * (x.size * self.dtype.itemsize)).from_address(x.ptr)
        view = np.frombuffer(memory, self.dtype).reshape(x.shape)
        self._views[x.ptr, x.size, x.ndim] = view
        return view

    def _address(self, x: wp.array) -> int:
        self.view(x)  # raises an error for unsuitable arrays
        return int(x.ptr)

    def copy(self, source: wp.array, target: wp.array) -> None:
        values = self.view(source) if source.dtype is self.real else source.numpy()
        with np.errstate(over="ignore"):  # a number beyond float32 becomes infinite
            np.copyto(self.view(target), values, casting="same_kind")

    def clear(self, x: wp.array) -> None:
        self.view(x).fill(0.0)

    def axpby(
        self, a: float, x: wp.array, b: float, y: wp.array, out: wp.array | None = None
    ) -> None:
        self._arguments[:3] = *map(self._address, (x, y)), self._address(y if out is None else out)
        command, factors = self._sum_of_two
        factors[:] = a, b
        command.launch()

    def scale(self, a: float, x: wp.array) -> None:
        target = self.view(x)
        np.multiply(target, self.dtype.type(a), out=target)

    def projections(self, *calls: tuple[wp.array, int, wp.array]) -> Array:
        count = sum(rows for _, rows, _ in calls)
        if count > self._products.size:
            self._products = np.empty(max(2 * count, 16))
        room = self._products if self._shared is None else self._shared.partial_sums(count)
        arguments = [room.ctypes.data, 0 if self._shared is None else count, len(calls)]
        for stack, rows, v in calls:
            arguments += self._address(stack), self._address(v), rows
        if len(arguments) > self._listed.size:
            call = wp.zeros(3 + 3 * max(len(calls), 8), dtype=wp.uint64, device="cpu")
            self._listed, inputs = call.numpy(), [call, self._weights, self._spans, self._size]
            self._multiply = self._record(weighted_products, 1, inputs)
        self._listed[: len(arguments)] = arguments
        self._multiply.launch()
        return self._products[:count] if self._shared is None else self._shared.total(count)

    def lowest(self, x: wp.array, begin: int, end: int) -> float:
        return self._least_of_all(float(self.view(x)[begin:end].min()))

    def combine(
        self, x: wp.array, stack: wp.array, c: ArrayLike, out: wp.array, scale: float = 1.0
    ) -> None:
        c = np.asarray(c)
        if c.size >= self._coefficients.size:
            coefficients = wp.zeros(1 + max(2 * c.size, 16), dtype=wp.float64, device="cpu")
            self._coefficients, inputs = coefficients.numpy(), [self._call, coefficients, self.n]
            self._add_up = self._record(combinations, -(-self.n // SPAN), inputs)
        self._coefficients[0], self._coefficients[1 : 1 + c.size] = scale, c
        self._arguments[:4] = *map(self._address, (x, stack, out)), c.size
        self._add_up.launch()


class DeviceSpace(VectorSpace):
    """Vectors in the memory of a GPU, by Warp kernels, which run on "cpu" in tests."""

    def _allocate(self) -> None:
        self._blocks = self._spans.shape[1]
        blocks = Launcher(self.device, self._comm)  # of BLOCK_THREADS threads
        self._kernel = functools.cache(lambda template: blocks.compile(self.real, template)[0])
        self._reserve(32)

    def _reserve(self, rows: int) -> None:
        """Allocate memory for the coefficients and partial sums of `rows` rows."""
        self._rows, shape = rows, (rows, self._blocks)
        self._partial = wp.zeros(shape, dtype=wp.float64, device=self.device)
        pinned = wp.get_device(self.device).is_cuda
        self._partial_host = wp.zeros(shape, dtype=wp.float64, device="cpu", pinned=pinned)
        self._coefficients = wp.zeros(rows, dtype=wp.float64, device=self.device)
        # Pageable memory: a copy to the device is complete when wp.copy returns.
        self._coefficients_host = wp.zeros(rows, dtype=wp.float64, device="cpu")
        self._sums, self._staged = self._partial_host.numpy(), self._coefficients_host.numpy()
        self._products = np.empty(rows)

    def copy(self, source: wp.array, target: wp.array) -> None:
        wp.utils.array_cast(source, target)

    def clear(self, x: wp.array) -> None:
        x.zero_()

    def axpby(
        self, a: float, x: wp.array, b: float, y: wp.array, out: wp.array | None = None
    ) -> None:
        inputs = [a, x, b, y, y if out is None else out]
        wp.launch(self._kernel(axpby), self.n, inputs=inputs, device=self.device)

    def scale(self, a: float, x: wp.array) -> None:
        self.axpby(a, x, 0.0, x)

    def projections(self, *calls: tuple[wp.array, int, wp.array]) -> Array:
        count = sum(rows for _, rows, _ in calls)
        if count > self._rows:
            self._reserve(2 * count)
        row = 0
        for stack, rows, v in calls:
            partial = self._partial[row : row + rows]
            stack = stack.reshape((1, self.n)) if stack.ndim == 1 else stack
            inputs = [stack, self._weights, v, self._spans, self._size, partial]
            self._reduce(self._kernel(products), rows, inputs)
            row += rows
        self._fetch(count)
        if self._shared is None:
            return np.sum(self._sums[:count], axis=1, out=self._products[:count])
        self._shared.partial_sums(count)[:] = self._sums[:count].T
        return self._shared.total(count)

    def lowest(self, x: wp.array, begin: int, end: int) -> float:
        span = -(-(end - begin) // self._blocks)
        self._reduce(self._kernel(least), 1, [x, begin, end, span, self._partial])
        self._fetch(1)
        return self._least_of_all(float(self._sums[0].min()))

    def _reduce(self, kernel: wp.Kernel, rows: int, inputs: list[Any]) -> None:
        dim = rows, self._blocks
        wp.launch_tiled(kernel, dim=dim, inputs=inputs, block_dim=BLOCK_THREADS, device=self.device)

    def _fetch(self, rows: int) -> None:
        """Copy the blocks' partial sums of the rows to the host."""
        wp.copy(self._partial_host, self._partial, count=rows * self._blocks)
        wp.synchronize_device(self.device)

    def combine(
        self, x: wp.array, stack: wp.array, c: ArrayLike, out: wp.array, scale: float = 1.0
    ) -> None:
        count = np.size(c)
        if count > self._rows:
            self._reserve(2 * count)
        self._staged[:count] = c
        wp.copy(self._coefficients, self._coefficients_host, count=max(count, 1))
        inputs = [scale, x, stack, self._coefficients, count, out]
        wp.launch(self._kernel(combine_rows), self.n, inputs=inputs, device=self.device)
