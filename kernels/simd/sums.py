"""Products and combinations of long vectors on a CPU, at memory speed and in a fixed order.

The sums are written in C++, so that they use whole registers. The position of a number in its chunk
decides which partial sum it joins. Unlike in BLAS, the bits therefore do not depend on memory
addresses. Vectors are passed by address, so that one recorded command serves any of them.
"""

from typing import Any

import warp as wp

from swe_sphere.kernels.define import Register, kernel, source

SPAN = 256
"""Count of numbers combined at a time, which fit the nearest cache."""
TOGETHER = 2048
"""Count of numbers in adjacent chunks that are summed row by row, so that rows are read in runs."""
Call = wp.array(dtype=wp.uint64)
Weights = wp.array(dtype=wp.float64)
Spans = wp.array3d(dtype=wp.int32)


@Register.func_native(f"const long together = {TOGETHER};" + source("add_products"))
def add_products(call: Call, weights: Weights, spans: Spans, size: int): ...


@kernel
def weighted_products(call: Call, weights: Weights, spans: Spans, size: int):
    """Add up weighted products in one thread: weights (n,), spans (kinds, chunks, 2).

    call: the address of p, d, the number of triples, and for each triple the addresses of a stack
    (m, n) and of v (n,) and the number of its rows to use. p[c d + s] becomes the sum of w_i
    stack[s, i] v_i over chunk c, in float64, where s numbers the rows of all triples. Chunk c
    contains the numbers i from spans[k, c, 0] to spans[k, c, 1], for all k, in each of the n / size
    fields. With d = 0, p[s] becomes the sum over all chunks, added in turn. All triples process a
    batch of about TOGETHER numbers before any processes the next batch.
    """
    add_products(call, weights, spans, size)


@Register.func_native(source("add_up"))
def add_up(nodes: wp.array2d(dtype=wp.int32), whole: int, sums: wp.array2d(dtype=wp.float64)): ...


@kernel
def tree(nodes: wp.array2d(dtype=wp.int32), whole: int, sums: wp.array2d(dtype=wp.float64)):
    """Sum rows of `sums` (n, width) along a binary tree in one thread.

    nodes: (n, 2), the first leaf and the number of leaves of each row. Two neighbours that are the
    halves of a branch merge into that branch, and the remaining rows move to the front. `whole`: 1
    if the rows cover all leaves; the last one is then added to the one before it until one remains.
    """
    add_up(nodes, whole, sums)


def _by_spans(code: str) -> Any:
    """Return the kernel (call, coefficients, n) of C++ code for the m of n numbers from `first` on.

    A thread handles up to SPAN (`most`) numbers; c are the coefficients in the code.
    """

    @Register.func_native(f"""
        const long most = {SPAN}, first = span * most, m = n - first < most ? n - first : most;
        const double* c = coefficients.data;
        {{{code}}}
    """)
    def in_span(span: int, call: Call, coefficients: Weights, n: int): ...

    @kernel
    def by_spans(call: Call, coefficients: Weights, n: int):
        in_span(wp.tid(), call, coefficients, n)

    return by_spans


combinations = _by_spans(source("combinations"))
"""Kernel (call, coefficients (1 + m,) float64, n) with one thread per SPAN numbers.

call: addresses of x (n,), a stack (m, n) and out (n,), and the number of rows m.  out = c_0 (x +
sum_s c_(1 + s) stack[s]); `out` may be `x`.
"""
scaled_sum = _by_spans(source("scaled_sum"))
"""Kernel (call, coefficients (2,) float64, n): c_0 x + c_1 y, each product rounded separately.

call: the addresses of x, y and the result (n,), which may be x or y.
"""
