"""Kernels with one thread for each group of elements, the launch shape for CPUs.

Each SIMD lane holds one element, so that every product of the tensor derivative is one instruction
for `lanes` elements; the work arrays of a group stay in the first-level cache.
"""

from typing import Any

import warp as wp

from swe_sphere.kernels.define import func, rows, specialise, vector
from swe_sphere.kernels.diffusion import diffusion
from swe_sphere.kernels.formulas import Formula
from swe_sphere.kernels.simd.arithmetic import line_sums
from swe_sphere.kernels.terms import KernelTypes, geometry, local, np_, output

Finish = Any
"""Function (geometry, x, result, k, node, direct) for nodes inside elements, which need no DSS.

The function multiplies the rows of a result by the inverse area and steps or stores them.  `k` is
the first field of the result, `node` the number of the node in the first element of the group."""


def element_sweep(t: KernelTypes, f: Formula, finish: Finish = None) -> tuple[Any, Any]:
    """Return functions that apply the formula to the elements of a group e.

    The first one, (geometry, a, x, e), loads winds that all fields share. The second one,
    (geometry, a, x, at, k, e, n, out, direct), then applies the formula to x[at:] and stores fields
    in `out` from the k-th on; n is unused. `finish` stores inner nodes in `direct`.
    """
    (d1, d2), store = line_sums(t.np, f.rows), _store(f, finish)
    scalar, needs_winds, edges_only = f.is_scalar, f.needs_winds, f.edges_only
    kind, kept, shared = f.rows, f.winds, f.shares_winds
    wind, operands, result = f.load_winds, f.operands, f.result
    at_1, at_2, at_winds = scratch(t, kind, kind, kept)

    @func
    def load_winds(geo: geometry, a: vector, x: vector, e: int):
        if wp.static(shared):
            winds = wp.array(ptr=geo.work + at_winds, shape=(np_, np_), dtype=kept)
            for i in range(np_):
                for j in range(np_):
                    winds[i, j] = wind(geo, a, x, e, i * np_ + j)

    @func
    def finish_node(
        geo: geometry, x: vector, winds: wp.array2d(dtype=kept), f1: wp.array2d(dtype=kind),
        f2: wp.array2d(dtype=kind), k: int, e: int, i: int, j: int, out: local, direct: output,
    ):  # fmt: skip
        s1 = d1(geo.derivative, f1, i, j)
        s2 = d2(geo.derivative, f2, i, j)
        store(geo, x, result(geo, winds[i, j], s1, s2, e, i * np_ + j), k, e, i, j, out, direct)

    @func
    def sweep(
        geo: geometry, a: vector, x: vector, at: int, k: int, e: int, n: int, out: local,
        direct: output,
    ):  # fmt: skip
        f1 = wp.array(ptr=geo.work + at_1, shape=(np_, np_), dtype=kind)
        f2 = f1
        if wp.static(not scalar):
            f2 = wp.array(ptr=geo.work + at_2, shape=(np_, np_), dtype=kind)
        winds = wp.array(ptr=geo.work + at_winds, shape=(np_, np_), dtype=kept)
        for i in range(np_):
            for j in range(np_):
                at_node = i * np_ + j
                if wp.static(shared):  # noqa: SIM108 - a static choice needs an if
                    w = winds[i, j]
                else:
                    w = wind(geo, a, x, e, at_node)
                if wp.static(needs_winds):
                    winds[i, j] = w
                r1, r2 = operands(geo, w, a, x, at, e, at_node)
                f1[i, j] = r1
                if wp.static(not scalar):
                    f2[i, j] = r2
        for i in range(np_):
            for j in range(np_):
                # Warp turns a `continue` into a guard of every later node, which slows all steps
                if wp.static(not edges_only):  # noqa: SIM114
                    finish_node(geo, x, winds, f1, f2, k, e, i, j, out, direct)
                elif i == 0 or i == np_ - 1 or j == 0 or j == np_ - 1:
                    finish_node(geo, x, winds, f1, f2, k, e, i, j, out, direct)

    return load_winds, sweep


def _store(f: Formula, finish: Finish) -> Any:
    """Return the function (geometry, x, result, k, e, i, j, out, direct) that stores fields."""
    kind, keep = rows(f.fields), keep_fields(f.fields)

    @func
    def store(
        geo: geometry, x: vector, r: kind, k: int, e: int, i: int, j: int, out: local,
        direct: output,
    ):  # fmt: skip
        n = i * np_ + j
        if wp.static(finish is None):
            keep(r, e, n, k, out)
        elif e < geo.block_groups and i > 0 and i < np_ - 1 and j > 0 and j < np_ - 1:
            finish(geo, x, r, k, ~geo.nodes[e, n][0], direct)
        else:
            keep(r, e, n, k, out)

    return store


def keep_fields(fields: int) -> Any:
    """Return the function (result, e, n, k, out) that stores fields in `out` from the k-th on."""

    @func
    def keep(r: rows(fields), e: int, n: int, k: int, out: local):
        out[e, n, k] = r[0]
        if wp.static(fields > 1):
            out[e, n, k + 1] = r[1]
        if wp.static(fields > 2):
            out[e, n, k + 2] = r[2]

    return keep


def element_diffusion(t: KernelTypes, finish_of: Any = None) -> Any:
    """Return the function (geometry, x, e, n, out, direct) for weak Laplacians in a group e.

    finish_of: function from a number of fields to their `Finish`. n is unused.
    """
    last = t.terms.unknowns - 1
    of_height = _laplacian(t, diffusion(t.terms, True, False), last, finish_of and finish_of(1))
    of_wind = last and _laplacian(t, diffusion(t.terms, False, True), 0, finish_of and finish_of(2))

    @func
    def diffuse(geo: geometry, x: vector, e: int, n: int, out: local, direct: output):
        of_height(geo, x, e, out, direct)
        if wp.static(last > 0):  # one by one, so that the first-level cache suffices
            of_wind(geo, x, e, out, direct)

    return diffuse


def _laplacian(t: KernelTypes, f: Formula, first: int, finish: Finish) -> Any:
    """Return the function (geometry, x, e, out, direct) for the fields from `first` on."""
    kind, store, scalar, order = f.rows, _store(f, finish), f.is_scalar, t.np
    load_winds, operands, fluxes, result = f.load_winds, f.operands, f.fluxes, f.result
    (d1, d2), (t1, t2) = line_sums(order, kind), line_sums(order, kind, transposed=True)
    at_1, at_2, at_3, at_4 = scratch(t, kind, kind, kind, kind)

    @func
    def laplacian(geo: geometry, x: vector, e: int, out: local, direct: output):
        f1 = wp.array(ptr=geo.work + at_1, shape=(np_, np_), dtype=kind)
        f2 = f1
        if wp.static(not scalar):
            f2 = wp.array(ptr=geo.work + at_2, shape=(np_, np_), dtype=kind)
        g1 = wp.array(ptr=geo.work + at_3, shape=(np_, np_), dtype=kind)
        g2 = wp.array(ptr=geo.work + at_4, shape=(np_, np_), dtype=kind)
        for i in range(np_):
            for j in range(np_):
                n = i * np_ + j
                r1, r2 = operands(geo, load_winds(geo, x, x, e, n), x, x, 0, e, n)
                f1[i, j] = r1
                if wp.static(not scalar):
                    f2[i, j] = r2
        for i in range(np_):
            for j in range(np_):
                s1 = d1(geo.derivative, f1, i, j)
                s2 = d2(geo.derivative, f2, i, j)
                r1, r2 = fluxes(geo, s1, s2, e, i * np_ + j)
                g1[i, j] = r1
                g2[i, j] = r2
        for i in range(np_):
            for j in range(np_):
                s1 = t1(geo.derivative, g1, i, j)
                s2 = t2(geo.derivative, g2, i, j)
                r = result(geo, s1, s2, e, i * np_ + j, out)
                store(geo, x, r, first, e, i, j, out, direct)

    return laplacian


def scratch(t: KernelTypes, *kinds: Any) -> list[Any]:
    """Return offsets [bytes] in a group's work memory for arrays (np, np) of these types.

    Arrays that a kernel allocates through Warp are zeroed first and not aligned to cache lines.
    """
    sizes = [t.np * t.np * wp.types.type_size_in_bytes(specialise(kind, t)) for kind in kinds]
    assert sum(sizes) <= work_bytes(t.np)
    return [wp.uint64(sum(sizes[:i])) for i in range(len(sizes))]


def work_bytes(np_: int) -> int:
    """Return the size of a group's work memory [bytes]: 16 registers per node."""
    return 16 * 64 * np_ * np_
