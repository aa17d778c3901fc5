"""Kernels with one thread for each element node, the launch shape for GPUs.

Each thread computes the rows to differentiate at its own node, then sums the rows of the element's
other threads along the two lines of nodes through its node. A weak Laplacian needs two nested line
sums: a first kernel writes the fluxes of all nodes, the tendency kernel their weak divergence.
"""

from typing import Any

import warp as wp

from swe_sphere.kernels.define import func, kernel, vector
from swe_sphere.kernels.diffusion import diffusion
from swe_sphere.kernels.element import keep_fields
from swe_sphere.kernels.formulas import Formula
from swe_sphere.kernels.simd.shared_lines import shared_lines
from swe_sphere.kernels.terms import KernelTypes, geometry, local, np_, output


def node_sweep(t: KernelTypes, f: Formula) -> Any:
    """Return the function (geometry, a, x, at, k, e, n, out, direct) of a formula at a node.

    The function reads x[at:] and stores fields in `out` from the k-th on; `direct` is unused.
    """
    derivatives, keep = _derivatives(t.np, f), keep_fields(f.fields)
    winds, load_winds, result = f.winds, f.load_winds, f.result
    needs_winds = f.needs_winds

    @func
    def sweep(
        geo: geometry, a: vector, x: vector, at: int, k: int, e: int, n: int, out: local,
        direct: output,
    ):  # fmt: skip
        s1, s2 = derivatives(geo, a, x, at, e, n)
        w = winds()
        if wp.static(needs_winds):
            w = load_winds(geo, a, x, e, n)
        keep(result(geo, w, s1, s2, e, n), e, n, k, out)

    return sweep


def _derivatives(order: int, f: Formula) -> Any:
    """Return the function (geometry, a, x, at, e, n) for the derivatives along each coordinate."""
    operands, load_winds = f.operands, f.load_winds

    @func
    def at_node(geo: geometry, a: vector, x: vector, at: int, e: int, n: int):
        return operands(geo, load_winds(geo, a, x, e, n), a, x, at, e, n)

    return _line_sums(order, f.rows, "points", at_node, transposed=False)


def _line_sums(order: int, rows: Any, name: str, at_node: Any, transposed: bool) -> Any:
    """Return the function (geometry, a, x, at, e, n) for the line sums along each coordinate.

    at_node: the function of the same arguments that returns the two `rows` to sum.
    """
    enter, turns, put, meet, along, across = shared_lines(rows, order, name, transposed)

    @func
    def line_sums(geo: geometry, a: vector, x: vector, at: int, e: int, n: int):
        i = n // np_
        j = n % np_
        room = enter(n)
        for turn in range(turns(n)):
            r1, r2 = at_node(geo, a, x, at, e, n + turn)
            put(room, n + turn, r1, r2)
        meet()
        return along(room, geo.derivative, i, j), across(room, geo.derivative, i, j)

    return line_sums


def node_diffusion(t: KernelTypes) -> tuple[Any, Any]:
    """Return the kernel and the function of weak Laplacians at element nodes.

    The kernel (geometry, x) stores in `geometry.fluxes` (..., np*np, 4) the two contravariant
    fluxes of the height and, if the wind diffuses, W div V and W curl V with the GLL weights W.
    The function (geometry, x, e, n, out, direct) then computes their weak divergence.
    """
    moves = t.terms.unknowns == 3
    formula = diffusion(t.terms, height=True, wind=moves)
    derivatives, to_fluxes, rows = _derivatives(t.np, formula), formula.fluxes, formula.rows
    result, keep = formula.result, keep_fields(formula.fields)

    @kernel
    def flux(geo: geometry, x: vector):
        e, n = wp.tid()
        s1, s2 = derivatives(geo, x, x, 0, e, n)
        r1, r2 = to_fluxes(geo, s1, s2, e, n)
        geo.fluxes[e, n, 0] = r1[0]
        geo.fluxes[e, n, 1] = r2[0]
        if wp.static(moves):
            geo.fluxes[e, n, 2] = r1[1]
            geo.fluxes[e, n, 3] = r1[2]

    @func
    def fluxes(geo: geometry, a: vector, x: vector, at: int, e: int, n: int):
        r1 = rows()
        r2 = rows()
        r1[0] = geo.fluxes[e, n, 0]
        r2[0] = geo.fluxes[e, n, 1]
        if wp.static(moves):
            for k in range(1, 3):
                r1[k] = geo.fluxes[e, n, 1 + k]
                r2[k] = geo.fluxes[e, n, 1 + k]
        return r1, r2

    line_sums = _line_sums(t.np, rows, "fluxes", fluxes, transposed=True)

    @func
    def diffuse(geo: geometry, x: vector, e: int, n: int, out: local, direct: output):
        t1, t2 = line_sums(geo, x, x, 0, e, n)
        keep(result(geo, t1, t2, e, n, out), e, n, 0, out)

    return flux, diffuse
