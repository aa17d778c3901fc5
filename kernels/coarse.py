"""Coarse functions: transfers from and to fields on elements, and sparse products between them."""

import functools
from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.access import entry_of, gather_run
from swe_sphere.kernels.assembly import OPTIONS, Contributors
from swe_sphere.kernels.registers import (
    columns_products,
    entries_sum,
    functions_sum,
    rows_product,
)
from swe_sphere.kernels.terms import kernel_types


@functools.cache
def coarse_kernels(np_: int, functions: int, real: type, shape: str) -> SimpleNamespace:
    """Kernels for `functions` coarse functions on an element, with nodal `values` (k, np*np).

    `restrict`, over (groups, k / `shares[0]`) threads: integrals (groups, k) over each element of a
    field times each function, with the weights `mass` (groups, np*np) [m2].  `assembled`, over the
    functions: their sums, of up to four places and of more.  `prolong`, over (groups, np*np /
    `shares[1]`): adds to a field the functions times the coefficients, those of an element at its
    `numbers` (groups, k); with the same bits for a node in each of its elements.
    """
    t = kernel_types(np_, real, shape, whole=False)
    load, mul, value, points = t.ops.load, t.ops.mul, t.value, np_ * np_
    few, many = (functions, points) if shape == "element" else (1, 1)
    integrals = rows_product(value, real, t.lanes, few, points)
    at_point = functions_sum(value, real, t.lanes, functions, points)
    matrix, each, table = wp.array2d(dtype=real), wp.array2d(dtype=value), wp.array2d(dtype=t.index)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def restrict(values: matrix, mass: each, b: t.local, out: each):
        e, part = wp.tid()
        weighted = wp.zeros(shape=points, dtype=value)
        for n in range(points):
            weighted[n] = mul(mass[e, n], b[e, n, 0])
        sums = wp.zeros(shape=few, dtype=value)
        integrals(values, part * few, weighted, sums)
        for k in range(few):
            out[e, part * few + k] = sums[k]

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def prolong(values: matrix, numbers: table, coefficients: t.vector, x: t.local):
        e, part = wp.tid()
        mine = wp.zeros(shape=functions, dtype=value)
        for k in range(functions):
            mine[k] = load(coefficients, 0, numbers[e, k])
        for n in range(part * many, part * many + many):
            x[e, n, 0] = x[e, n, 0] + at_point(values, n, mine)

    gather, places = gather_run(real, Contributors, real, 1), wp.array(dtype=Contributors)
    place = entry_of(Contributors)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def assembled(four: places, more: places, local: t.vector, out: t.vector):
        row = wp.tid()
        total = gather(local, four, row, 0)
        if place(more, row)[0] >= 0:
            total += gather(local, more, row, 0)
        out[row] = total

    return SimpleNamespace(
        restrict=restrict, assembled=assembled, prolong=prolong, shares=(few, many)
    )


@functools.cache
def sweep_kernel(real: type, shape: str) -> wp.Kernel:
    """Kernel over groups of `lanes` rows of a `SlicedMatrix`: a Chebyshev step.

    The `values` of group g, from at[g] to at[g + 1], are coefficients of the numbers that begin at
    d[begin]; vectors have a `value` a group, and d a flat view.  r -= M d, after = keep d + take
    r/diagonal, x = before + beta after; `after` is another array than d.
    """
    t = kernel_types(1, real, shape, whole=False)
    mul, value = t.ops.mul, t.value
    numbers, rows, flat = wp.array(dtype=wp.int32), wp.array(dtype=value), wp.array(dtype=real)
    row = entries_sum(value, real, t.lanes, "*registers(from)")

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def sweep(
        at: numbers,
        begin: numbers,
        values: rows,
        per_diagonal: rows,
        keep: real,
        take: real,
        beta: real,
        flat_d: flat,
        d: rows,
        r: rows,
        before: rows,
        after: rows,
        x: rows,
    ):
        g = wp.tid()
        residual = r[g] - row(at, begin, values, flat_d, g)
        step = keep * d[g] + take * mul(per_diagonal[g], residual)
        r[g] = residual
        after[g] = step
        x[g] = before[g] + beta * step

    return sweep


@functools.cache
def tall_kernels(real: type, shape: str) -> SimpleNamespace:
    """Kernels over groups of `lanes` rows of a `TallMatrix`, which share their columns.

    The `values` of group g, from at[g] to at[g + 1], are those of its rows in one column each.

    `product`: out = M x, or out + M x if `add`.  `parts`: what each group adds to M' y in each of
    its columns.  `total`, over the columns: the sums of their parts, which are `listed` by column
    from ends[c] to ends[c + 1].
    """
    t = kernel_types(1, real, shape, whole=False)
    numbers, rows = wp.array(dtype=wp.int32), wp.array(dtype=t.value)
    flat = wp.array(dtype=real)
    row = entries_sum(t.value, real, t.lanes, "*from")
    products = columns_products(t.value, real, t.lanes)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def product(at: numbers, columns: numbers, values: rows, x: flat, add: int, out: rows):
        g = wp.tid()
        total = row(at, columns, values, x, g)
        if add > 0:
            total += out[g]
        out[g] = total

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def parts(at: numbers, values: rows, y: rows, out: flat):
        products(at, values, y, wp.tid(), out)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def total(ends: numbers, listed: numbers, parts: flat, out: flat):
        c = wp.tid()
        found = real(0.0)
        for k in range(ends[c], ends[c + 1]):
            found += parts[listed[k]]
        out[c] = found

    return SimpleNamespace(product=product, parts=parts, total=total)
