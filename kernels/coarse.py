"""Transfers between fields on elements and coefficients of coarse functions; sparse products."""

import functools
from typing import Any

import warp as wp

from swe_sphere.kernels.define import index, kernel, real, source, specialise, value, vector
from swe_sphere.kernels.simd import arithmetic
from swe_sphere.kernels.simd.arithmetic import columns_products, mul
from swe_sphere.kernels.simd.memory import Numbers, load_runs, run_table
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
    integrate = arithmetic.integrate_functions(few, points)
    add = arithmetic.add_functions(functions, points)

    @kernel
    def restrict(begin: int, values: matrix, mass: each, b: local, out: each):
        e, part = wp.tid()
        integrate(values, mass, b, begin + e, part * few, functions, out)

    @kernel
    def prolong(
        begin: int, values: matrix, numbers: wp.array2d(dtype=index), coefficients: vector, x: local
    ):  # fmt: skip
        e, part = wp.tid()
        add(values, numbers, coefficients, begin + e, part * many, part * many + many, x)

    return specialise(restrict, t), specialise(prolong, t), (few, many)


@kernel
def assemble(
    at: Numbers, runs: wp.array(dtype=run_table), others: wp.array(dtype=index), field: vector,
    out: registers,
):  # fmt: skip
    """Sum the integrals of each function, over groups of `lanes` functions.

    The contributions to group g are `runs` from at[g] to at[g + 1]; for `others` see `in_runs`.
    """
    g = wp.tid()
    total = load_runs(field, runs[at[g]], others)
    for k in range(at[g] + 1, at[g + 1]):
        total += load_runs(field, runs[k], others)
    out[g] = total


runs_sum = arithmetic.entries_sum("*runs(from)", source("converted_entry"), wp.int16)
numbers_sum = arithmetic.entries_sum("*from", "runs(values.data)[k]", value)


@kernel
def coarse_step(
    at: Numbers, begin: Numbers, values: wp.array(dtype=wp.int16), unit: real,
    per_diagonal: registers, size: real, b: registers, flat_x: vector, x: registers,
    after: registers,
):  # fmt: skip
    """Take a Chebyshev step over groups of `lanes` rows of a `SlicedMatrix`.

    The `values` of group g are entries k from at[g] to at[g + 1], in units of `unit`; entry k
    multiplies the register at flat_x[begin[k]], where flat_x is x as a flat array. Vectors have one
    register per group. The step is after = x + size (b/diagonal - M x); `after` is not x.
    """
    g = wp.tid()
    product = unit * runs_sum(at, begin, values, flat_x, g)
    after[g] = x[g] + size * (mul(per_diagonal[g], b[g]) - product)


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
