"""Linear combinations of state vectors."""

import functools

import warp as wp

MAX_TERMS = 16


@functools.cache
def combine_kernel(real: type) -> wp.Kernel:
    """Kernel (x (n,), stack (m, n), coefficients, count, out (n,)): out = x + sum_s c[s] stack[s].

    Rows with a zero coefficient are not read.  `out` may be `x`.
    """
    row = wp.types.vector(MAX_TERMS, real)

    @wp.kernel(module="unique", enable_backward=False, module_options={"max_unroll": 1})
    def combine(
        x: wp.array(dtype=real),
        stack: wp.array2d(dtype=real),
        coefficients: row,
        count: int,
        out: wp.array(dtype=real),
    ) -> None:
        i = wp.tid()
        r = x[i]
        for s in range(count):
            if coefficients[s] != real(0.0):
                r += coefficients[s] * stack[s, i]
        out[i] = r

    return combine


@functools.cache
def combine_rows_kernel(real: type) -> wp.Kernel:
    """Kernel (scale, x (n,), stack (m, n), coefficients (m,) float64, count, out (n,)).

    out = scale (x + sum_{s < count} c[s] stack[s]) for any number of rows; `out` may be `x`.
    """

    @wp.kernel(module="unique", enable_backward=False, module_options={"max_unroll": 1})
    def combine_rows(
        scale: wp.float64,
        x: wp.array(dtype=real),
        stack: wp.array2d(dtype=real),
        coefficients: wp.array(dtype=wp.float64),
        count: int,
        out: wp.array(dtype=real),
    ) -> None:
        i = wp.tid()
        r = x[i]
        for s in range(count):
            r += real(coefficients[s]) * stack[s, i]
        out[i] = real(scale) * r

    return combine_rows


@functools.cache
def axpby_kernel(real: type) -> wp.Kernel:
    """Kernel (a, x (n,), b, y (n,)): y = a x + b y, with a and b float64."""

    @wp.kernel(module="unique", enable_backward=False, module_options={"max_unroll": 1})
    def axpby(
        a: wp.float64, x: wp.array(dtype=real), b: wp.float64, y: wp.array(dtype=real)
    ) -> None:
        i = wp.tid()
        y[i] = real(a) * x[i] + real(b) * y[i]

    return axpby


@functools.cache
def products_kernel(real: type) -> wp.Kernel:
    """Kernel (stack (m, n), weights (n,) float64, v (n,), span, partial (m, blocks) float64).

    To be launched tiled over (rows, blocks): partial[s, b] = the part of sum_i w_i stack[s, i] v_i
    with b span <= i < (b + 1) span.  The sums run in float64 and in an order fixed by the launch,
    without atomics, so that a run repeats bit by bit; the caller adds the blocks up.
    """

    @wp.kernel(module="unique", enable_backward=False, module_options={"max_unroll": 1})
    def products(
        stack: wp.array2d(dtype=real),
        weights: wp.array(dtype=wp.float64),
        v: wp.array(dtype=real),
        span: int,
        partial: wp.array2d(dtype=wp.float64),
    ) -> None:
        row, block, lane = wp.tid()
        end = wp.min((block + 1) * span, v.shape[0])
        total = wp.float64(0.0)
        for i in range(block * span + lane, end, wp.block_dim()):
            total += weights[i] * wp.float64(stack[row, i]) * wp.float64(v[i])
        wp.tile_store(partial[row], wp.tile_sum(wp.tile(total)), offset=block)

    return products
