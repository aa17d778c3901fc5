"""Sums and products of SIMD registers."""

import functools
from typing import Any

import warp as wp

from swe_sphere.kernels.define import Placeholder, Register, index, real, source, value, vector
from swe_sphere.kernels.simd.memory import Numbers


@Register.func_native(source("product"))
def product(p: value, q: value) -> value:
    """Return the product of whole registers, lane by lane."""


def _product(register: Register) -> Any:
    if register.lanes == 1:
        return wp.mul
    return product.find(register) if register.whole else wp.cw_mul


mul: Any = Placeholder(_product)
"""Function (p, q) that returns the product."""
div: Any = Placeholder(lambda of: wp.cw_div if of.lanes > 1 else wp.div)
"""Function (p, q) that returns the quotient."""


@Register.func_native(source("clip"))
def clip(x: value, low: value, high: value) -> value:
    """Return x limited to [low, high]; Warp's own functions would compile to function calls."""


@functools.cache
def line_sums(np_: int, kind: Any = value, transposed: bool = False) -> tuple[Any, Any]:
    """Return device functions (derivative, field (np, np), i, j) for derivatives along xi1 and xi2.

    Fields have the type `kind`. If `transposed`, both apply the transpose of the derivative matrix.
    """

    def line_sum(factor: str, node: str) -> Any:
        """Return the device function for the sum over m of d[factor] times f[node]."""

        @Register.func_native(source("line_sum", np=np_, factor=factor, node=node))
        def line_sum(
            d: wp.array2d(dtype=real), f: wp.array2d(dtype=kind), i: int, j: int
        ) -> kind: ...

        return line_sum

    first, second = (f"m * {np_} + {k}" if transposed else f"{k} * {np_} + m" for k in "ij")
    return line_sum(first, f"m * {np_} + j"), line_sum(second, f"i * {np_} + m")


@functools.cache
def integrate_functions(rows: int, columns: int) -> Any:
    """Return the device function that integrates b times coarse functions over group e of elements.

    out[e, k] becomes the sum over n of m[k, n] mass[e, n] b[e, n], for `rows` functions k from
    `first` on, four at a time, so that their additions overlap; `out` has shape (groups, of_all).
    """

    @Register.func_native(source("integrate_functions", rows=rows, columns=columns))
    def integrate(
        m: wp.array2d(dtype=real), mass: wp.array2d(dtype=value), b: wp.array3d(dtype=value),
        e: int, first: int, of_all: int, out: wp.array2d(dtype=value),
    ): ...  # fmt: skip

    return integrate


@functools.cache
def add_functions(functions: int, points: int) -> Any:
    """Return the device function that adds coarse functions to x at points from `begin` to `end`.

    Group e of elements has the functions `numbers`, multiplied by the coefficients there. The last
    12 functions are three patterns at each corner. The patterns of a corner are added first, so
    that an edge has the same sums in both its elements.
    """
    given = {"functions": functions, "smooth": functions - 12, "points": points}

    @Register.func_native(source("add_functions", **given))
    def add(
        values: wp.array2d(dtype=real), numbers: wp.array2d(dtype=index), coefficients: vector,
        e: int, begin: int, end: int, x: wp.array3d(dtype=value),
    ): ...  # fmt: skip

    return add


def entries_sum(factor: str, entry: str, stored: Any) -> Any:
    """Return the device function (at, places, values, x, g) for M x in group g of a sparse matrix.

    The matrix is a `SlicedMatrix` or `TallMatrix`. factor: C++ for the register or number that
    entry k multiplies, where `from` points to the number x[places[k]]; entry: C++ for entry k of
    `values`, whose type is `stored`. The entries of a row are added in turn; adjacent rows, which
    differ from rank to rank, add only zeros to this sum.
    """

    @Register.func_native(source("entries_sum", factor=factor, entry=entry))
    def row(
        at: Numbers, places: Numbers, values: wp.array(dtype=stored), x: vector, g: int
    ) -> value: ...

    return row


@Register.func_native(source("columns_products"))
def columns_products(
    at: Numbers, values: wp.array(dtype=value), y: wp.array(dtype=value), g: int, out: vector
):
    """Store in out[k] the contribution of entry k, one column of group g, to M^T y."""


@functools.cache
def _rooms(register: Register) -> Any:
    attributes, widened = "", "wide(r)"
    if register.lanes > 1:
        attributes = f"__attribute__((ext_vector_type({register.lanes}), aligned(sizeof(double))))"
        widened = "__builtin_convertvector(r, wide)"

    @Register.func_native(source("rooms", attributes=attributes, widened=widened))
    def rooms(
        area: wp.array(dtype=wp.float64), x: vector, depth: int, first: int, begin: int, end: int,
        low: real, high: real,
    ) -> wp.types.vector(3, wp.float64): ...  # fmt: skip

    return rooms.find(register)


rooms: Any = Placeholder(_rooms)
"""Function (area, x, depth, first, begin, end, low, high) that returns a limiter's sums over nodes.

The sums are the excess of the masses over their bounds and the room above and below, see
`limiter.py`.  The offset of a number from `begin`, not its address, selects its partial sum.
"""
