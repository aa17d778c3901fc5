"""Products and combinations of long vectors on a CPU: as fast as memory, in an order of their own.

In C++, for sums in whole registers.  A number is added to the sum of its place after the beginning
of its chunk, so that the bits do not depend on where in memory a chunk stands, as those of BLAS do.
Vectors come by their addresses: one recorded command serves all of them.
"""

from typing import Any

import warp as wp

from swe_sphere.kernels.define import Register, kernel, source

SPAN = 256
"""Numbers that are combined at a time: they stay in the nearest cache."""
TOGETHER = 2048
"""Numbers of chunks side by side whose sums are taken row by row: a row is read in long runs."""
Call = wp.array(dtype=wp.uint64)
Weights = wp.array(dtype=wp.float64)
Spans = wp.array3d(dtype=wp.int32)


@Register.func_native(f"const long together = {TOGETHER};" + source("add_products"))
def add_products(call: Call, weights: Weights, spans: Spans, size: int): ...


@kernel
def weighted_products(call: Call, weights: Weights, spans: Spans, size: int):
    """Add up weighted products: weights (n,), spans (kinds, chunks, 2); of one thread.

    call: the address of p, d, how many triples follow, and of each the addresses of a stack (m, n)
    and of v (n,) and how many rows of the stack count.  p[c d + s] = the part of
    sum_i w_i stack[s, i] v_i of chunk c, s over the rows of all triples; a chunk is the numbers
    from spans[k, c, 0] to spans[k, c, 1], all k, of each of the n / size fields; in float64.  With
    d = 0 the parts are added up, one after the other.  All triples go by some chunks at a time.
    """
    add_products(call, weights, spans, size)


@Register.func_native(source("add_up"))
def add_up(nodes: wp.array2d(dtype=wp.int32), whole: int, sums: wp.array2d(dtype=wp.float64)): ...


@kernel
def tree(nodes: wp.array2d(dtype=wp.int32), whole: int, sums: wp.array2d(dtype=wp.float64)):
    """Add up sums (n, width) along a binary tree of `nodes` (n, 2); of one thread.

    nodes: the first leaf and the number of leaves of each.  Two that stand side by side and are the
    halves of a branch become that branch, and what is left stands in front; where these are all
    leaves of the tree, `whole`, the last is added to the one before it, until one is left.
    """
    add_up(nodes, whole, sums)


def _by_spans(code: str) -> Any:
    """Return the kernel (call, coefficients, n) of C++ for the m of n numbers from `first` on.

    A thread takes up to SPAN (`most`) numbers; c are the coefficients in the code.
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
"""Kernel (call, coefficients (1 + m,) float64, n), a thread for each SPAN numbers.

call: addresses of x (n,), a stack (m, n) and out (n,), and how many rows.  out = c_0 (x + sum_s
c_(1 + s) stack[s]); `out` may be `x`.
"""
scaled_sum = _by_spans(source("scaled_sum"))
"""Kernel (call, coefficients (2,) float64, n): c_0 x + c_1 y, either product rounded by itself.

call: the addresses of x, y and the result (n,), which may be one of them.
"""
