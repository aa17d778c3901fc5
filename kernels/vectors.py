"""Linear combinations of state vectors, steps among them, and numbers brought to other places."""

import functools
from typing import Any

import warp as wp

from swe_sphere.kernels.define import kernel
from swe_sphere.kernels.simd.memory import entry_of, put_of
from swe_sphere.kernels.simd.register import Register

AT_ONCE = 4
"""Vectors that one kernel adds up."""


@functools.cache
def combine_kernel(real: Any, count: int) -> wp.Kernel:
    """Kernel (x, vector, factor, ..., out), all (n,): out = x + the sum of 1 to 4 scaled vectors.

    One kernel for each count and no loop over rows: four times faster on a CPU.  `out` may be `x`.
    """
    vector, entry, put = wp.array(dtype=real), entry_of(real), put_of(Register(real))

    @kernel
    def add_1(x: vector, a: vector, ca: real, out: vector) -> None:
        i = wp.tid()
        put(out, i, entry(x, i) + ca * entry(a, i))

    @kernel
    def add_2(x: vector, a: vector, ca: real, b: vector, cb: real, out: vector) -> None:
        i = wp.tid()
        put(out, i, entry(x, i) + ca * entry(a, i) + cb * entry(b, i))

    @kernel
    def add_3(
        x: vector, a: vector, ca: real, b: vector, cb: real, c: vector, cc: real, out: vector
    ) -> None:
        i = wp.tid()
        put(out, i, entry(x, i) + ca * entry(a, i) + cb * entry(b, i) + cc * entry(c, i))

    @kernel
    def add_4(
        x: vector, a: vector, ca: real, b: vector, cb: real, c: vector, cc: real, d: vector,
        cd: real, out: vector,
    ) -> None:  # fmt: skip
        i = wp.tid()
        r = entry(x, i) + ca * entry(a, i) + cb * entry(b, i)
        put(out, i, r + cc * entry(c, i) + cd * entry(d, i))

    return (add_1, add_2, add_3, add_4)[count - 1]


@functools.cache
def combine_rows_kernel(real: Any) -> wp.Kernel:
    """Kernel (scale, x (n,), stack (m, n), coefficients (m,) float64, count, out (n,)).

    out = scale (x + sum_{s < count} c[s] stack[s]) for any number of rows; `out` may be `x`.
    """

    @kernel
    def combine_rows(
        scale: wp.float64, x: wp.array(dtype=real), stack: wp.array2d(dtype=real),
        coefficients: wp.array(dtype=wp.float64), count: int, out: wp.array(dtype=real),
    ) -> None:  # fmt: skip
        i = wp.tid()
        r = x[i]
        for s in range(count):
            r += real(coefficients[s]) * stack[s, i]
        out[i] = real(scale) * r

    return combine_rows


@functools.cache
def axpby_kernel(real: Any) -> wp.Kernel:
    """Kernel (a, x (n,), b, y (n,)): y = a x + b y, with a and b float64."""

    @kernel
    def axpby(
        a: wp.float64, x: wp.array(dtype=real), b: wp.float64, y: wp.array(dtype=real)
    ) -> None:
        i = wp.tid()
        y[i] = real(a) * x[i] + real(b) * y[i]

    return axpby


@functools.cache
def products_kernel(real: Any) -> wp.Kernel:
    """Kernel (stack (m, n), weights (n,) float64, v (n,), spans (kinds, c, 2), size, partial).

    To be launched tiled over (rows, chunks): partial[s, c], float64 (m, c), becomes the part of
    sum_i w_i stack[s, i] v_i of chunk c, the numbers from spans[k, c, 0] to spans[k, c, 1], all k,
    of each of the n / size fields.  The sums run in float64 and in an order fixed by the launch,
    without atomics, so that a run repeats bit by bit; the caller adds the chunks up.
    """

    @kernel
    def products(
        stack: wp.array2d(dtype=real), weights: wp.array(dtype=wp.float64),
        v: wp.array(dtype=real), spans: wp.array3d(dtype=wp.int32), size: int,
        partial: wp.array2d(dtype=wp.float64),
    ) -> None:  # fmt: skip
        row, chunk, lane = wp.tid()
        total = wp.float64(0.0)
        for field in range(0, v.shape[0], size):
            for kind in range(spans.shape[0]):
                end = field + spans[kind, chunk, 1]
                for i in range(field + spans[kind, chunk, 0] + lane, end, wp.block_dim()):
                    total += weights[i] * wp.float64(stack[row, i]) * wp.float64(v[i])
        wp.tile_store(partial[row], wp.tile_sum(wp.tile(total)), offset=chunk)

    return products


@functools.cache
def least_kernel(real: Any) -> wp.Kernel:
    """Kernel (x (n,), begin, end, span, partial (1, blocks) float64), launched as `products`.

    partial[0, b] = the least of x[i] with b span <= i - begin < (b + 1) span and i < end; infinity
    where there is none, -infinity where one is NaN.
    """

    @kernel
    def least(
        x: wp.array(dtype=real), begin: int, end: int, span: int,
        partial: wp.array2d(dtype=wp.float64),
    ) -> None:  # fmt: skip
        row, block, lane = wp.tid()
        last = wp.min(begin + (block + 1) * span, end)
        found = wp.float64(wp.inf)
        for i in range(begin + block * span + lane, last, wp.block_dim()):
            value = wp.float64(x[i])
            found = wp.where(wp.isnan(value), -wp.float64(wp.inf), wp.min(found, value))
        wp.tile_store(partial[row], wp.tile_min(wp.tile(found)), offset=block)

    return least


@functools.cache
def nearness_kernel(real: Any) -> wp.Kernel:
    """Kernel (share, x (m,), first, then (n,), out (n,)): how far from leaving numbers are.

    out = share |now| - |now - then|, where now is x from `first` on; NaN where one is.
    """

    @kernel
    def nearness(
        share: real, x: wp.array(dtype=real), first: int, then: wp.array(dtype=real),
        out: wp.array(dtype=real),
    ) -> None:  # fmt: skip
        i = wp.tid()
        now = x[first + i]
        out[i] = share * wp.abs(now) - wp.abs(now - then[i])

    return nearness


@functools.cache
def leapfrog_kernel(real: Any) -> wp.Kernel:
    """Kernel (previous, state, tendency, two_dt, displacement, share): one filtered leapfrog step.

    With x- the filtered past, x the present and k the tendency, x+ = x- + 2 dt k and the
    displacement d = (nu/2)(x- - 2x + x+), where `displacement` is nu/2; `previous` becomes
    x + share d and `state` becomes x+ - (1 - share) d (Williams 2009, doi:10.1175/2009MWR2724.1,
    eqs. 7-9).
    """

    entry, put = entry_of(real), put_of(Register(real))

    @kernel
    def leapfrog(
        previous: wp.array(dtype=real), state: wp.array(dtype=real),
        tendency: wp.array(dtype=real), two_dt: real, displacement: real, share: real,
    ):  # fmt: skip
        i = wp.tid()
        x = entry(state, i)
        future = entry(previous, i) + two_dt * entry(tendency, i)
        d = displacement * (entry(previous, i) - real(2.0) * x + future)
        put(previous, i, x + share * d)
        put(state, i, future - (real(1.0) - share) * d)

    return leapfrog
