"""Sums and products of SIMD registers."""

import functools
from typing import Any

import warp as wp

from swe_sphere.kernels.simd.register import Register


@functools.cache
def product_of(register: Register) -> Any:
    """Return the Warp function (p, q): the product, lane by lane."""
    if register.lanes == 1:
        return wp.mul

    @register.func_native("""
        run r = *runs(&p);
        r *= *runs(&q);
        return as_value(r);
    """)
    def product(p: register.value, q: register.value) -> register.value: ...

    return product


@functools.cache
def clip_of(register: Register) -> Any:
    """Return the Warp function (x, low, high): x, or the bound that x is beyond.

    The functions of Warp are calls in C++.
    """

    @register.func_native("""
        const run least = *runs(&low), most = *runs(&high);
        run r = *runs(&x);
        r = r > least ? r : least;
        r = r < most ? r : most;
        return as_value(r);
    """)
    def clip(x: register.value, low: register.value, high: register.value) -> register.value: ...

    return clip


@functools.cache
def line_sum(register: Register, np_: int, rows: Any, factor: str, node: str) -> Any:
    """Return the Warp function (d, f, i, j): the sum over m of d at `factor` times f at `node`.

    The indices are C++ in i, j and m.  rows: the type of f, of one or several registers.
    """
    size = wp.types.type_size_in_bytes
    count = size(rows) // size(register.value)
    matrix, field = wp.array2d(dtype=register.real), wp.array2d(dtype=rows)

    @register.func_native(f"""
        run sums[{count}];
        #pragma unroll
        for (int m = 0; m < {np_}; ++m) {{
            const auto a = d.data[{factor}];
            const auto at = reinterpret_cast<const run*>(f.data + ({node}));
            #pragma unroll
            for (int k = 0; k < {count}; ++k) {{
                const run product = a * at[k];
                sums[k] = m > 0 ? sums[k] + product : product;
            }}
        }}
        auto r = *f.data;
        const runs each = runs(&r);
        #pragma unroll
        for (int k = 0; k < {count}; ++k) each[k] = sums[k];
        return r;
    """)
    def line_sum(d: matrix, f: field, i: int, j: int) -> rows: ...

    return line_sum


@functools.cache
def rows_product(register: Register, rows: int, columns: int) -> Any:
    """Return the Warp function (m, first, x, y): y[k] = sum over n of m[first + k, n] x[n].

    It computes `rows` sums, four at a time, which do not wait for each other.
    """
    vector, matrix = wp.array(dtype=register.value), wp.array2d(dtype=register.real)

    @register.func_native(f"""
        const auto from = runs(x.data), to = runs(y.data);
        for (int k = 0; k < {rows}; k += 4) {{
            const int count = {rows} - k < 4 ? {rows} - k : 4;
            const auto row = m.data + (first + k) * {columns};
            run sums[4] = {{}};
            const auto add = [&](int r, int n) {{ sums[r] += row[r * {columns} + n] * from[n]; }};
            for (int n = 0; n < {columns}; ++n)
                if (count == 4) {{ add(0, n); add(1, n); add(2, n); add(3, n); }}
                else for (int r = 0; r < count; ++r) add(r, n);
            for (int r = 0; r < count; ++r) to[k + r] = sums[r];
        }}
    """)
    def product(m: matrix, first: int, x: vector, y: vector): ...

    return product


@functools.cache
def functions_sum(register: Register, functions: int, points: int) -> Any:
    """Return the Warp function (values, n, c): sum of coarse functions, times c, at point n.

    The patterns of a corner are added up first: an edge has the same sums in both its elements.
    """
    smooth = functions - 12
    matrix, vector = wp.array2d(dtype=register.real), wp.array(dtype=register.value)

    @register.func_native(f"""
        const auto at = runs(c.data);
        const auto part = [&](int k) {{ return values.data[k * {points} + n] * at[k]; }};
        run sum = part(0), modes = {{}};
        for (int k = 1; k < {smooth}; ++k) {{ const run hat = part(k); sum += hat; }}
        for (int k = {smooth}; k < {smooth} + 4; ++k) {{
            const run first = part(k + 4), second = part(k + 8), both = part(k);
            const run along = first + second;
            const run corner = both + along;
            modes += corner;
        }}
        sum += modes;
        return as_value(sum);
    """)
    def sum_at_point(values: matrix, n: int, c: vector) -> register.value: ...

    return sum_at_point


@functools.cache
def entries_sum(register: Register, factor: str) -> Any:
    """Return the Warp function (at, places, values, x, g): M x in group g of a sparse matrix.

    The matrix is a `SlicedMatrix` or `TallMatrix`.  factor: what entry k is a coefficient of, a C++
    register or number at `from`, which is x at the entry's place.  The entries of a row are added
    one after the other: the rows beside it, which differ from rank to rank, only add zeros.
    """
    numbers, rows = wp.array(dtype=wp.int32), wp.array(dtype=register.value)

    @register.func_native(f"""
        const auto part = [&](int k) {{
            const auto from = x.data + places.data[k];
            return runs(values.data)[k] * {factor};
        }};
        run sum = {{}};
        for (int k = at.data[g]; k < at.data[g + 1]; ++k) sum += part(k);
        return as_value(sum);
    """)
    def row(
        at: numbers, places: numbers, values: rows, x: wp.array(dtype=register.real), g: int
    ) -> register.value: ...

    return row


@functools.cache
def columns_products(register: Register) -> Any:
    """Return the Warp function (at, values, y, g, out): the part of group g in M' y, by columns."""
    numbers, rows = wp.array(dtype=wp.int32), wp.array(dtype=register.value)

    @register.func_native(f"""
        for (int k = at.data[g]; k < at.data[g + 1]; ++k) {{
            run product = runs(values.data)[k] * runs(y.data)[g];
            const auto each = reinterpret_cast<number*>(&product);
            for (int half = {register.lanes} / 2; half > 0; half /= 2)
                for (int i = 0; i < half; ++i) each[i] += each[i + half];
            out.data[k] = each[0];
        }}
    """)
    def products(
        at: numbers, values: rows, y: rows, g: int, out: wp.array(dtype=register.real)
    ): ...

    return products


@functools.cache
def rooms_of(register: Register) -> Any:
    """Return the Warp function (area, x, depth, first, begin, end, low, high): sums over nodes.

    The sums are the excess of the masses over their bounds and the room above and below.  A number
    is added to the sum of its place after the beginning, wherever in memory that is.
    """
    lanes, vector = register.lanes, wp.array(dtype=register.real)
    attributes = f"__attribute__((ext_vector_type({lanes}), aligned(sizeof(double))))"
    as_wide = "__builtin_convertvector(r, wide)" if lanes > 1 else "wide(r)"

    @register.func_native(f"""
        typedef double wide {attributes if lanes > 1 else ""};
        wide sums[3] = {{}};
        const auto add = [&](auto mass, auto air, auto space, auto to) {{
            const auto least = low * air, most = high * air;
            auto clipped = mass > least ? mass : least;
            clipped = clipped < most ? clipped : most;
            const auto over = mass - clipped, above = most - clipped, below = clipped - least;
            to(0, over, space); to(1, above, space); to(2, below, space);
        }};
        int i = begin;
        for (; i + {lanes} <= end; i += {lanes})
            add(*runs(x.data + first + i), *runs(x.data + depth + i), *(const wide*)(area.data + i),
                [&](int s, run r, wide a) {{ sums[s] += a * {as_wide}; }});
        double left[3] = {{}};
        for (; i < end; ++i)
            add(x.data[first + i], x.data[depth + i], area.data[i],
                [&](int s, auto r, double a) {{ left[s] += a * double(r); }});
        wp::vec3d total;
        for (int s = 0; s < 3; ++s) {{
            total[s] = left[s];
            for (int lane = 0; lane < {lanes}; ++lane)
                total[s] += reinterpret_cast<const double*>(&sums[s])[lane];
        }}
        return total;
    """)
    def rooms(
        area: wp.array(dtype=wp.float64), x: vector, depth: int, first: int, begin: int, end: int,
        low: register.real, high: register.real,
    ) -> wp.types.vector(3, wp.float64): ...  # fmt: skip

    return rooms
