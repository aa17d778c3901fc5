"""Transfers between fields on elements and coefficients of coarse functions; sparse products."""

import functools
from typing import Any

import warp as wp

from swe_sphere.kernels.define import index, kernel, real, specialise, value, vector
from swe_sphere.kernels.simd.arithmetic import (
    columns_products,
    entries_sum,
    functions_sum,
    mul,
    rows_product,
)  # fmt: skip
from swe_sphere.kernels.simd.memory import Numbers, Places, gather, load_nodes
from swe_sphere.kernels.terms import KernelTypes, local

matrix, each = wp.array2d(dtype=real), wp.array2d(dtype=value)
registers = wp.array(dtype=value)


@functools.cache
def transfer_kernels(t: KernelTypes, functions: int) -> tuple[Any, Any, tuple[int, int]]:
    """Return the kernels for k coarse functions on an element, with nodal `values` (k, np*np).

    `restrict` stores the integrals (groups, k) over each element of a field times each function,
    with the weights `mass` (groups, np*np) [m2]; it runs over (groups, k / `shares[0]`) threads.
    `prolong` adds to a field the sum of the functions times the coefficients at the element's
    `numbers` (groups, k). It runs over (groups, np*np / `shares[1]`) threads and gives a shared
    node the same bits in each of its elements. The third result is `shares`.
    """
    points = t.np * t.np
    few, many = (functions, points) if t.shape == "element" else (1, 1)
    integrals, at_point = rows_product(few, points), functions_sum(functions, points)

    @kernel
    def restrict(begin: int, values: matrix, mass: each, b: local, out: each):
        e, part = wp.tid()
        e += begin
        weighted = wp.zeros(shape=points, dtype=value)
        for n in range(points):
            weighted[n] = mul(mass[e, n], b[e, n, 0])
        sums = wp.zeros(shape=few, dtype=value)
        integrals(values, part * few, weighted, sums)
        for k in range(few):
            out[e, part * few + k] = sums[k]

    @kernel
    def prolong(
        begin: int, values: matrix, numbers: wp.array2d(dtype=index), coefficients: vector, x: local
    ):  # fmt: skip
        e, part = wp.tid()
        e += begin
        mine = wp.zeros(shape=functions, dtype=value)
        for k in range(functions):
            mine[k] = load_nodes(coefficients, 0, numbers[e, k])
        for n in range(part * many, part * many + many):
            x[e, n, 0] = x[e, n, 0] + at_point(values, n, mine)

    return specialise(restrict, t), specialise(prolong, t), (few, many)


@kernel
def assemble(four: Places, more: Places, field: vector, out: vector):
    """Sum the integrals of each function; `four` lists up to four contributors, `more` the rest."""
    row = wp.tid()
    total = gather(field, four, row, 0)
    if more[row][0] >= 0:
        total += gather(field, more, row, 0)
    out[row] = total


runs_sum, numbers_sum = entries_sum("*runs(from)"), entries_sum("*from")


@kernel
def chebyshev_step(
    at: Numbers, begin: Numbers, values: registers, per_diagonal: registers, keep: real, take: real,
    beta: real, flat_d: vector, d: registers, r: registers, before: registers, after: registers,
    x: registers,
):  # fmt: skip
    """Take a Chebyshev step over groups of `lanes` rows of a `SlicedMatrix`.

    The `values` of group g are entries k from at[g] to at[g + 1]; entry k multiplies the register
    at flat_d[begin[k]], where flat_d is d as a flat array. Vectors have one register per group. The
    step is r -= M d, after = keep d + take r/diagonal, x = before + beta after; `after` is not d.
    """
    g = wp.tid()
    residual = r[g] - runs_sum(at, begin, values, flat_d, g)
    step = keep * d[g] + take * mul(per_diagonal[g], residual)
    r[g] = residual
    after[g] = step
    x[g] = before[g] + beta * step


@kernel
def tall_product(at: Numbers, columns: Numbers, values: registers, x: vector, out: registers):
    """Set out = M x, over groups of `lanes` rows of a `TallMatrix`.

    The rows of a group share their columns. The `values` of group g are entries k from at[g] to
    at[g + 1]; entry k belongs to columns[k].
    """
    g = wp.tid()
    out[g] = numbers_sum(at, columns, values, x, g)


@kernel
def tall_parts(at: Numbers, values: registers, y: registers, out: vector):
    """Store in out[k] the contribution of entry k, one column of a group of rows, to M^T y."""
    columns_products(at, values, y, wp.tid(), out)


@kernel
def tall_total(ends: Numbers, listed: Numbers, parts: vector, out: vector):
    """Sum the contributions parts[listed[k]], with k from ends[c] to ends[c + 1], of column c."""
    c = wp.tid()
    found = real(0.0)
    for k in range(ends[c], ends[c + 1]):
        found += parts[listed[k]]
    out[c] = found
