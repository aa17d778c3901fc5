"""Arithmetic of SIMD registers in C++, which the compiler would take apart as Warp writes it.

Of the loops over lanes in Warp's vectors it makes whole registers in most places, but pieces in
others.  A statement has one operation, so that none are contracted.
"""

import functools
from typing import Any

import warp as wp


def run_type(real: type, lanes: int) -> tuple[str, str]:
    """C++ of a register: the name of its number type, and what makes `run` its own name."""
    kind = f"wp::{real.__name__}"
    attributes = f"__attribute__((ext_vector_type({lanes}), aligned(sizeof({kind}))))"
    return kind, f"typedef {kind} run {attributes if lanes > 1 else ''};"


@functools.cache
def product_of(value: type, real: type, lanes: int) -> Any:
    """Warp function (p, q): the product of two registers, lane by lane."""
    kind, register = run_type(real, lanes)

    @wp.func_native(f"""
        {register}
        run r, s;
        __builtin_memcpy(&r, &p, sizeof p);
        __builtin_memcpy(&s, &q, sizeof q);
        r *= s;
        wp::vec_t<{lanes}, {kind}> v;
        __builtin_memcpy(&v, &r, sizeof v);
        return v;
    """)
    def product(p: value, q: value) -> value: ...

    return product


@functools.cache
def clip_of(value: type, real: type, lanes: int) -> Any:
    """Warp function (x, low, high): x, or the bound it is beyond; Warp's own are calls in C++."""
    _, register = run_type(real, lanes)

    @wp.func_native(f"""
        {register}
        typedef const run* runs;
        const run least = *runs(&low), most = *runs(&high);
        run r = *runs(&x);
        r = r > least ? r : least;
        r = r < most ? r : most;
        auto v = x;
        *reinterpret_cast<run*>(&v) = r;
        return v;
    """)
    def clip(x: value, low: value, high: value) -> value: ...

    return clip


@functools.cache
def line_sum(rows: type, real: type, lanes: int, np_: int, factor: str, node: str) -> Any:
    """Warp function (d, f, i, j): the sum over m of d at `factor` times f at `node`.

    The indices are C++ in i, j and m.
    """
    _, register = run_type(real, lanes)
    count = wp.types.type_size_in_bytes(rows) // wp.types.type_size_in_bytes(real) // lanes
    matrix, field = wp.array2d(dtype=real), wp.array2d(dtype=rows)

    @wp.func_native(f"""
        {register}
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
        #pragma unroll
        for (int k = 0; k < {count}; ++k) reinterpret_cast<run*>(&r)[k] = sums[k];
        return r;
    """)
    def line_sum(d: matrix, f: field, i: int, j: int) -> rows: ...

    return line_sum


@functools.cache
def rows_product(value: type, real: type, lanes: int, rows: int, columns: int) -> Any:
    """Warp function (m, first, x, y): y[k] = sum over n of m[first + k, n] x[n], for k < `rows`.

    Four rows at a time: their sums do not wait for each other.
    """
    _, register = run_type(real, lanes)
    vector, matrix = wp.array(dtype=value), wp.array2d(dtype=real)

    @wp.func_native(f"""
        {register}
        const auto from = reinterpret_cast<const run*>(x.data);
        const auto to = reinterpret_cast<run*>(y.data);
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
def functions_sum(value: type, real: type, lanes: int, functions: int, points: int) -> Any:
    """Warp function (values, n, c): the sum of coarse functions, times c, at point n of an element.

    Those of a corner's patterns add up first.  A statement has one operation, so that none are
    contracted: an edge has the same sums in either of its elements.
    """
    _, register = run_type(real, lanes)
    matrix, vector, smooth = wp.array2d(dtype=real), wp.array(dtype=value), functions - 12

    @wp.func_native(f"""
        {register}
        const auto at = reinterpret_cast<const run*>(c.data);
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
        auto r = *c.data;
        *reinterpret_cast<run*>(&r) = sum;
        return r;
    """)
    def sum_at_point(values: matrix, n: int, c: vector) -> value: ...

    return sum_at_point


@functools.cache
def entries_sum(value: type, real: type, lanes: int, factor: str) -> Any:
    """Warp function (at, places, values, x, g): M x in group g of a `SlicedMatrix` or `TallMatrix`.

    factor: what entry k is a coefficient of, a C++ register or number at `from`, which is x at the
    entry's place.  A row's entries one after the other: the rows beside it, which differ from rank
    to rank, only add zeros.
    """
    _, run = run_type(real, lanes)
    numbers, rows, flat = wp.array(dtype=wp.int32), wp.array(dtype=value), wp.array(dtype=real)

    @wp.func_native(f"""
        {run}
        typedef const run* registers;
        const auto part = [&](int k) {{
            const auto from = x.data + places.data[k];
            return registers(values.data)[k] * {factor};
        }};
        run sum = {{}};
        for (int k = at.data[g]; k < at.data[g + 1]; ++k) sum += part(k);
        auto v = *values.data;
        *reinterpret_cast<run*>(&v) = sum;
        return v;
    """)
    def row(at: numbers, places: numbers, values: rows, x: flat, g: int) -> value: ...

    return row


@functools.cache
def columns_products(value: type, real: type, lanes: int) -> Any:
    """Warp function (at, values, y, g, out): what group g adds to M' y, for each of its columns."""
    kind, run = run_type(real, lanes)
    numbers, rows, flat = wp.array(dtype=wp.int32), wp.array(dtype=value), wp.array(dtype=real)

    @wp.func_native(f"""
        {run}
        typedef const run* registers;
        for (int k = at.data[g]; k < at.data[g + 1]; ++k) {{
            run product = registers(values.data)[k] * registers(y.data)[g];
            const auto each = reinterpret_cast<{kind}*>(&product);
            for (int half = {lanes} / 2; half > 0; half /= 2)
                for (int i = 0; i < half; ++i) each[i] += each[i + half];
            out.data[k] = each[0];
        }}
    """)
    def products(at: numbers, values: rows, y: rows, g: int, out: flat): ...

    return products
