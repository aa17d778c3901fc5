"""Vector arithmetic on the CPU: numpy on the memory of the Warp arrays, without copies.

Only numpy's BLAS is called, never scipy's: each brings its own pool of spinning threads, and calls
that alternate between the two were seen to take 100 times as long.
"""

import ctypes
import functools
import math

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.arrays import Array

Floats = NDArray[np.floating]

# Columns converted to float64 at a time when the vectors are float32: a strip of a stack stays in
# cache.
STRIP = 4096
MOST_VIEWS = 512
# What is not finite shows in the sums; the solvers report it.
QUIETLY = functools.partial(np.errstate, invalid="ignore", over="ignore")


class HostVectors:
    """The operations of `VectorSpace` on device "cpu"; see there for their meaning."""

    def __init__(self, weights: Array, real: type, device: str = "cpu") -> None:
        self.real, self.n = real, weights.size
        self.dtype = np.dtype(wp.dtype_to_numpy(real))
        self._weights = weights
        self._weighted = np.empty(self.n)
        self._strip = np.empty((0, 0))
        self._products = np.empty(64)
        self._views: dict[tuple[int, int, int], Floats] = {}
        self._double = self.dtype == np.float64
        self._sum = np.empty(self.n, self.dtype)

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
        term = self.view(x)
        if a != 1.0:
            term = np.multiply(term, self.dtype.type(a), out=self._sum)
        target = self.view(y)
        if b != 1.0:
            np.multiply(target, self.dtype.type(b), out=target)
        np.add(target, term, out=target)

    def scale(self, a: float, x: wp.array) -> None:
        target = self.view(x)
        np.multiply(target, self.dtype.type(a), out=target)

    def dot(self, a: wp.array, b: wp.array) -> float:
        with QUIETLY():
            weighted = np.multiply(self._weights, self.view(a), out=self._weighted)
            if self._double:
                return float(np.dot(weighted, self.view(b)))
            return float(self._strips(self.view(b)[None, :], weighted, self._room(1))[0])

    def lowest(self, x: wp.array, begin: int, end: int) -> float:
        lowest = float(self.view(x)[begin:end].min())
        return -math.inf if math.isnan(lowest) else lowest

    def project(self, stack: wp.array, count: int, v: wp.array) -> Array:
        with QUIETLY():
            weighted = np.multiply(self._weights, self.view(v), out=self._weighted)
            rows, out = self.view(stack)[:count], self._room(count)
            if self._double:
                return np.dot(rows, weighted, out=out)
            return self._strips(rows, weighted, out)

    def combine_rows(
        self, scale: float, x: wp.array, stack: wp.array, coefficients: Array, out: wp.array
    ) -> None:
        rows = self.view(stack)[: len(coefficients)]
        target = self.view(out)
        np.dot(coefficients.astype(self.dtype, copy=False), rows, out=self._sum)
        np.add(self.view(x), self._sum, out=target)
        if scale != 1.0:
            np.multiply(target, self.dtype.type(scale), out=target)

    def _room(self, count: int) -> Array:
        """Where `count` products go: valid until the next call."""
        if count > self._products.size:
            self._products = np.empty(2 * count)
        return self._products[:count]

    def _strips(self, rows: Floats, weighted: Array, out: Array) -> Array:
        """rows @ weighted for float32 rows, summed in float64."""
        out.fill(0.0)
        count = len(rows)
        if count > len(self._strip):
            self._strip = np.empty((count, STRIP))
        for start in range(0, self.n, STRIP):
            piece = rows[:, start : start + STRIP]
            strip = self._strip[:count, : piece.shape[1]]
            np.copyto(strip, piece)
            out += strip @ weighted[start : start + STRIP]
        return out
