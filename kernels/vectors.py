"""Linear combinations of state vectors, time steps among them, and reductions.

All vectors have shape (n,), with one thread per number unless stated otherwise.
"""

import warp as wp

from swe_sphere.kernels.define import kernel, real, vector
from swe_sphere.kernels.simd.memory import load, put

numbers = wp.array(dtype=wp.float64)
stacked = wp.array2d(dtype=real)


@kernel
def add_1(x: vector, a: vector, ca: real, out: vector):
    i = wp.tid()
    put(out, i, load(x, i) + ca * load(a, i))


@kernel
def add_2(x: vector, a: vector, ca: real, b: vector, cb: real, out: vector):
    i = wp.tid()
    put(out, i, load(x, i) + ca * load(a, i) + cb * load(b, i))


@kernel
def add_3(x: vector, a: vector, ca: real, b: vector, cb: real, c: vector, cc: real, out: vector):
    i = wp.tid()
    put(out, i, load(x, i) + ca * load(a, i) + cb * load(b, i) + cc * load(c, i))


@kernel
def add_4(
    x: vector, a: vector, ca: real, b: vector, cb: real, c: vector, cc: real, d: vector, cd: real,
    out: vector,
):  # fmt: skip
    i = wp.tid()
    put(out, i, load(x, i) + ca * load(a, i) + cb * load(b, i) + cc * load(c, i) + cd * load(d, i))


ADDERS = {1: add_1, 2: add_2, 3: add_3, 4: add_4}
"""Kernels (x, vector, factor, ..., out) by the number of vectors: out = x + sum(factor * vector).

A loop over rows takes four times as long on a CPU. `out` may be `x`.
"""


@kernel
def combine_rows(
    scale: wp.float64, x: vector, stack: stacked, coefficients: numbers, count: int, out: vector
):
    """Set out = scale (x + sum_{s < count} c[s] stack[s]) for any count; `out` may be `x`."""
    i = wp.tid()
    r = x[i]
    for s in range(count):
        r += real(coefficients[s]) * stack[s, i]
    out[i] = real(scale) * r


@kernel
def axpby(a: wp.float64, x: vector, b: wp.float64, y: vector, out: vector):
    """Set out = a x + b y; `out` may be x or y."""
    i = wp.tid()
    out[i] = real(a) * x[i] + real(b) * y[i]


@kernel
def products(
    stack: stacked, weights: numbers, v: vector, spans: wp.array3d(dtype=wp.int32), size: int,
    partial: wp.array2d(dtype=wp.float64),
):  # fmt: skip
    """Add up products of vectors in chunks; launched tiled over (rows, chunks).

    partial[s, c] becomes the sum of w_i stack[s, i] v_i over chunk c: the numbers i from spans[k,
    c, 0] to spans[k, c, 1], for all k, in each of the n / size fields. The sums run in float64 in
    an order fixed by the launch, without atomics: runs repeat bit by bit. Callers add the chunks.
    """
    row, chunk, lane = wp.tid()
    total = wp.float64(0.0)
    first = lane
    for field in range(0, v.shape[0], size):
        for kind in range(spans.shape[0]):
            begin = field + spans[kind, chunk, 0]
            end = field + spans[kind, chunk, 1]
            for i in range(begin + first, end, wp.block_dim()):
                total += weights[i] * wp.float64(stack[row, i]) * wp.float64(v[i])
            # the next lane continues, so that the sum does not depend on where a chunk is divided
            first = (first + wp.block_dim() - (end - begin) % wp.block_dim()) % wp.block_dim()
    wp.tile_store(partial[row], wp.tile_sum(wp.tile(total)), offset=chunk)


@kernel
def least(x: vector, begin: int, end: int, span: int, partial: wp.array2d(dtype=wp.float64)):
    """Find the minimum of each block; launched as `products`.

    partial[0, b] = the minimum of x[i] with b span <= i - begin < (b + 1) span and i < end. This is
    infinity for an empty block, and -infinity if an x[i] is NaN.
    """
    row, block, lane = wp.tid()
    last = wp.min(begin + (block + 1) * span, end)
    found = wp.float64(wp.inf)
    for i in range(begin + block * span + lane, last, wp.block_dim()):
        value = wp.float64(x[i])
        found = wp.where(wp.isnan(value), -wp.float64(wp.inf), wp.min(found, value))
    wp.tile_store(partial[row], wp.tile_min(wp.tile(found)), offset=block)


@kernel
def nearness(share: real, x: vector, first: int, then: vector, out: vector):
    """Store share |now| - |now - then|, the distance to a bound on change; now starts at x[first].

    The result is NaN where an input is.
    """
    i = wp.tid()
    now = x[first + i]
    out[i] = share * wp.abs(now) - wp.abs(now - then[i])


@kernel
def leapfrog(
    begin: int, previous: vector, state: vector, change: vector, of_previous: real, of_state: real,
    of_change: real, displacement: real, share: real,
):  # fmt: skip
    """Take one filtered leapfrog step (Williams 2009, doi:10.1175/2009MWR2724.1, eqs. 7-9).

    The step applies to the numbers from `begin` on. With x- the filtered past and x the present, x+
    is the sum of x-, x and `change` times their factors `of_...`, and the displacement d = (nu/2)
    (x- - 2x + x+), where `displacement` is nu/2; `previous` becomes x + share d and `state` becomes
    x+ - (1 - share) d.
    """
    i = begin + wp.tid()
    x = load(state, i)
    future = of_previous * load(previous, i) + of_state * x + of_change * load(change, i)
    d = displacement * (load(previous, i) - real(2.0) * x + future)
    put(previous, i, x + share * d)
    put(state, i, future - (real(1.0) - share) * d)
