"""Coarse functions: transfers from and to fields on elements, and sparse products between them."""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from swe_sphere.kernels.define import kernel
from swe_sphere.kernels.simd.arithmetic import (
    columns_products,
    entries_sum,
    functions_sum,
    rows_product,
)
from swe_sphere.kernels.simd.memory import Contributors, entry_of, gather_of
from swe_sphere.kernels.simd.register import Register
from swe_sphere.kernels.terms import KernelTypes


@dataclass(frozen=True)
class CoarseKernels:
    """Kernels for k coarse functions on an element, with nodal `values` (k, np*np)."""

    restrict: wp.Kernel
    """Integrals (groups, k) over each element of a field times each function, with the weights
    `mass` (groups, np*np) [m2]; over (groups, k / `shares[0]`) threads."""
    assembled: wp.Kernel
    """Sums of the integrals of each function, at up to four places and at more; over the
    functions."""
    prolong: wp.Kernel
    """Adds to a field the functions times the coefficients, those of an element at its `numbers`
    (groups, k), with the same bits for a node in each of its elements; over (groups, np*np /
    `shares[1]`) threads."""
    shares: tuple[int, int]


@functools.cache
def coarse_kernels(np_: int, functions: int, real: Any, shape: str) -> CoarseKernels:
    """Return the kernels for so many functions."""
    t = KernelTypes(np_, real, shape, whole=False)
    load, mul, value, points = t.load, t.metric.mul, t.value, np_ * np_
    few, many = (functions, points) if shape == "element" else (1, 1)
    integrals = rows_product(t.register, few, points)
    at_point = functions_sum(t.register, functions, points)
    matrix, each, table = wp.array2d(dtype=real), wp.array2d(dtype=value), wp.array2d(dtype=t.index)

    @kernel
    def restrict(values: matrix, mass: each, b: t.local, out: each):
        e, part = wp.tid()
        weighted = wp.zeros(shape=points, dtype=value)
        for n in range(points):
            weighted[n] = mul(mass[e, n], b[e, n, 0])
        sums = wp.zeros(shape=few, dtype=value)
        integrals(values, part * few, weighted, sums)
        for k in range(few):
            out[e, part * few + k] = sums[k]

    @kernel
    def prolong(values: matrix, numbers: table, coefficients: t.vector, x: t.local):
        e, part = wp.tid()
        mine = wp.zeros(shape=functions, dtype=value)
        for k in range(functions):
            mine[k] = load(coefficients, 0, numbers[e, k])
        for n in range(part * many, part * many + many):
            x[e, n, 0] = x[e, n, 0] + at_point(values, n, mine)

    gather, places = gather_of(Register(real)), wp.array(dtype=Contributors)
    place = entry_of(Contributors)

    @kernel
    def assembled(four: places, more: places, local: t.vector, out: t.vector):
        row = wp.tid()
        total = gather(local, four, row, 0)
        if place(more, row)[0] >= 0:
            total += gather(local, more, row, 0)
        out[row] = total

    return CoarseKernels(restrict, assembled, prolong, (few, many))


@functools.cache
def sweep_kernel(real: Any, shape: str) -> wp.Kernel:
    """Return the kernel of a Chebyshev step, over groups of `lanes` rows of a `SlicedMatrix`.

    The `values` of group g, from at[g] to at[g + 1], are coefficients of the numbers that begin at
    d[begin]; vectors have a `value` a group, and d a flat view.  r -= M d, after = keep d + take
    r/diagonal, x = before + beta after; `after` is another array than d.
    """
    t = KernelTypes(1, real, shape, whole=False)
    mul, value = t.metric.mul, t.value
    numbers, rows, flat = wp.array(dtype=wp.int32), wp.array(dtype=value), wp.array(dtype=real)
    row = entries_sum(t.register, "*runs(from)")

    @kernel
    def sweep(
        at: numbers, begin: numbers, values: rows, per_diagonal: rows, keep: real, take: real,
        beta: real, flat_d: flat, d: rows, r: rows, before: rows, after: rows, x: rows,
    ):  # fmt: skip
        g = wp.tid()
        residual = r[g] - row(at, begin, values, flat_d, g)
        step = keep * d[g] + take * mul(per_diagonal[g], residual)
        r[g] = residual
        after[g] = step
        x[g] = before[g] + beta * step

    return sweep


@functools.cache
def tall_kernels(real: Any, shape: str) -> tuple[wp.Kernel, wp.Kernel, wp.Kernel]:
    """Return the kernels over groups of `lanes` rows of a `TallMatrix`, which share their columns.

    The `values` of group g, from at[g] to at[g + 1], are those of its rows in one column each.  The
    first kernel computes out = M x, or out + M x if `add`; the second one the part of each group in
    M' y, column by column.  The third one, over columns, adds up the parts, which are `listed` by
    column from ends[c] to ends[c + 1].
    """
    t = KernelTypes(1, real, shape, whole=False)
    numbers, rows = wp.array(dtype=wp.int32), wp.array(dtype=t.value)
    flat = wp.array(dtype=real)
    row, products = entries_sum(t.register, "*from"), columns_products(t.register)

    @kernel
    def product(at: numbers, columns: numbers, values: rows, x: flat, add: int, out: rows):
        g = wp.tid()
        total = row(at, columns, values, x, g)
        if add > 0:
            total += out[g]
        out[g] = total

    @kernel
    def parts(at: numbers, values: rows, y: rows, out: flat):
        products(at, values, y, wp.tid(), out)

    @kernel
    def total(ends: numbers, listed: numbers, parts: flat, out: flat):
        c = wp.tid()
        found = real(0.0)
        for k in range(ends[c], ends[c + 1]):
            found += parts[listed[k]]
        out[c] = found

    return product, parts, total
