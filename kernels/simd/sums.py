"""Products and combinations of long vectors on a CPU: as fast as memory, in an order of their own.

In C++, for sums in whole registers.  A number is added to the sum of its place after the beginning
of its chunk, so that the bits do not depend on where in memory a chunk stands, as those of BLAS do.
Vectors come by their addresses: one recorded command serves all of them.
"""

from typing import Any

import warp as wp

from swe_sphere.kernels.define import Register, kernel

SPAN = 256
"""Numbers that are combined at a time: they stay in the nearest cache."""
TOGETHER = 2048
"""Numbers of chunks side by side whose sums are taken row by row: a row is read in long runs."""
Call = wp.array(dtype=wp.uint64)
Weights = wp.array(dtype=wp.float64)
Spans = wp.array3d(dtype=wp.int32)


@Register.func_native(f"""
    typedef double eight __attribute__((ext_vector_type(8)));
    typedef long long places __attribute__((ext_vector_type(8)));
    struct one {{ enum {{ value = 1 }}; }};
    struct two {{ enum {{ value = 2 }}; }};
    struct three {{ enum {{ value = 3 }}; }};
    struct four {{ enum {{ value = 4 }}; }};
    const auto partial = reinterpret_cast<double*>(call.data[0]);
    const long apart = call.data[1];
    const auto first = call.data + 3, last = first + 3 * call.data[2];
    const long n = weights.shape[0], chunks = spans.shape[1];
    const auto all = [](const auto* x) {{
        typedef __typeof__(*x + 0) number;
        typedef number run __attribute__((ext_vector_type(8), aligned(sizeof(number))));
        return __builtin_convertvector(*reinterpret_cast<const run*>(x), eight);
    }};
    const auto front = [&](const auto* x, long i, long end) {{
        eight r = 0;
        if (i + 8 <= n)
            r = places{{0, 1, 2, 3, 4, 5, 6, 7}} < places(end - i) ? all(x + i) : r;
        else
            for (long j = i; j < end; ++j) r[j - i] = x[j];
        return r;
    }};
    typedef const number* numbers;
    const auto add = [&](auto count, numbers row, numbers v, long i, long end, double* to) {{
        eight p[count.value] = {{}};
        for (; i + 8 <= end; i += 8) {{
            const eight x = all(weights.data + i) * all(v + i);
            for (long r = 0; r < count.value; ++r) p[r] += x * all(row + r * n + i);
        }}
        if (i < end) {{
            const eight x = front(weights.data, i, end) * front(v, i, end);
            for (long r = 0; r < count.value; ++r) p[r] += x * front(row + r * n, i, end);
        }}
        for (long r = 0; r < count.value; ++r) {{
            const auto q = p[r].lo + p[r].hi;
            to[r] += (q[0] + q[2]) + (q[1] + q[3]);
        }}
    }};
    const auto project = [&](const auto* each, long field, const int* at, double* to, long m) {{
        auto row = reinterpret_cast<numbers>(each[0]);
        const auto v = reinterpret_cast<numbers>(each[1]);
        const auto rows = [&](auto count) {{
            for (long c = 0; c < m; ++c)
                add(count, row, v, field + at[2 * c], field + at[2 * c + 1], to + c * apart);
        }};
        long left = each[2];
        for (; left >= 4; left -= 4, row += 4 * n, to += 4) rows(four());
        if (left == 3) rows(three());
        if (left == 2) rows(two());
        if (left == 1) rows(one());
        return to + left;
    }};
    long sums = 0;
    for (auto each = first; each < last; each += 3) sums += each[2];
    for (long c = 0; c < chunks; ++c)
        for (long s = 0; s < sums; ++s) partial[c * apart + s] = 0.0;
    for (long field = 0; field < n; field += size)
        for (long k = 0; k < spans.shape[0]; ++k)
            for (long c = 0, behind; c < chunks; c = behind) {{
                const int* at = spans.data + 2 * k * chunks;
                long taken = 0;
                for (behind = c; behind < chunks && taken < {TOGETHER}; ++behind)
                    taken += at[2 * behind + 1] - at[2 * behind];
                double* to = partial + c * apart;
                for (auto each = first; each < last; each += 3)
                    to = project(each, field, at + 2 * c, to, behind - c);
            }}
""")
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


@Register.func_native("""
    const long n = sums.shape[0], width = sums.shape[1];
    int first[64], size[64];  // of the rows in front, whose sizes grow and then shrink
    long rows = 0;
    const auto merge = [&]() {
        double* to = sums.data + (rows - 2) * width;
        for (long k = 0; k < width; ++k) to[k] += to[width + k];
        --rows;
    };
    const auto are_halves = [&]() {
        const int at = rows - 2;
        return at >= 0 && size[at] == size[at + 1] && first[at] % (2 * size[at]) == 0;
    };
    for (long i = 0; i < n; ++i) {
        const double* from = sums.data + i * width;
        for (long k = 0; k < width; ++k) sums.data[rows * width + k] = from[k];
        first[rows] = nodes.data[2 * i];
        size[rows++] = nodes.data[2 * i + 1];
        for (; are_halves(); size[rows - 1] *= 2) merge();
    }
    while (whole && rows > 1) merge();
""")
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


combinations = _by_spans("""
    const auto x = reinterpret_cast<const number*>(call.data[0]) + first;
    const auto out = reinterpret_cast<number*>(call.data[2]) + first;
    const number scale = *c++;
    number sum[most] = {};
    auto row = reinterpret_cast<const number*>(call.data[1]) + first;
    long left = call.data[3];
    for (; left >= 4; left -= 4, row += 4 * n, c += 4) {
        const number a = c[0], b = c[1], d = c[2], e = c[3];
        const auto r = row + n, s = r + n, t = s + n;
        for (long i = 0; i < m; ++i) sum[i] += (a * row[i] + b * r[i]) + (d * s[i] + e * t[i]);
    }
    for (; left > 0; --left, row += n, ++c) {
        const number a = *c;
        for (long i = 0; i < m; ++i) sum[i] += a * row[i];
    }
    for (long i = 0; i < m; ++i) out[i] = scale * (x[i] + sum[i]);
""")
"""Kernel (call, coefficients (1 + m,) float64, n), a thread for each SPAN numbers.

call: addresses of x (n,), a stack (m, n) and out (n,), and how many rows.  out = c_0 (x + sum_s
c_(1 + s) stack[s]); `out` may be `x`.
"""
scaled_sum = _by_spans("""
    #pragma clang fp contract(off)
    const auto x = reinterpret_cast<const number*>(call.data[0]) + first;
    const auto y = reinterpret_cast<number*>(call.data[1]) + first;
    const number a = c[0], b = c[1];
    for (long i = 0; i < m; ++i) y[i] = a * x[i] + b * y[i];
""")
"""Kernel (call, coefficients (2,) float64, n): y = c_0 x + c_1 y, either product rounded by itself.

call: the addresses of x and y (n,).
"""
