"""One thread a group of elements: the launch shape for CPUs.

Each SIMD lane holds one element, so that every product of the tensor derivative is one instruction
for `lanes` elements; the work arrays of a group stay in the first-level cache.
"""

import functools
from typing import Any

import warp as wp

from swe_sphere.kernels.define import func, kernel
from swe_sphere.kernels.diffusion import diffusion
from swe_sphere.kernels.formulas import Formula
from swe_sphere.kernels.simd.arithmetic import line_sum
from swe_sphere.kernels.simd.register import Register
from swe_sphere.kernels.terms import KernelTypes

Finish = Any
"""Function (geometry, x, result, k, node, done) for nodes inside elements, which need no DSS: it
multiplies the rows of a result by the inverse area and steps or stores them.  `k` is the field with
which the result begins, `node` the number of the node in the first element of the group."""


def element_sweep(
    t: KernelTypes, f: Formula, finish: Finish = None, shared: bool = False
) -> tuple[Any, Any]:
    """Return functions that apply the formula to the elements of a group e.

    (geometry, a, x, e) loads winds that are `shared` by all fields; (geometry, a, x, at, k, e, out,
    done) then applies the formula at the offset `at` of x, for the k-th field of `out`.  With
    `finish`, nodes inside the elements, which need no DSS, go to `done` finished.
    """
    np_, geometry, vector = t.np, t.geometry, t.vector
    d1, d2, _, _ = line_sums(t.register, np_, f.rows)
    rows, kept, store = f.rows, f.winds, _store(t, f.fields, finish)
    at_1, at_2, at_winds, _ = scratch(np_, rows, rows, kept)

    @func
    def load_winds(geo: geometry, a: vector, x: vector, e: int):
        if wp.static(shared):
            winds = wp.array(ptr=geo.work + at_winds, shape=(np_, np_), dtype=kept)
            for i in range(np_):
                for j in range(np_):
                    winds[i, j] = f.wind(geo, a, x, e, i * np_ + j)

    @func
    def sweep(
        geo: geometry, a: vector, x: vector, at: int, k: int, e: int, out: t.local, done: t.done
    ):
        f1 = wp.array(ptr=geo.work + at_1, shape=(np_, np_), dtype=rows)
        f2 = f1
        if wp.static(not f.is_scalar):
            f2 = wp.array(ptr=geo.work + at_2, shape=(np_, np_), dtype=rows)
        winds = wp.array(ptr=geo.work + at_winds, shape=(np_, np_), dtype=kept)
        for i in range(np_):
            for j in range(np_):
                n = i * np_ + j
                if wp.static(shared):  # noqa: SIM108 - a static choice takes an if
                    w = winds[i, j]
                else:
                    w = f.wind(geo, a, x, e, n)
                if wp.static(f.turns):
                    winds[i, j] = w
                r1, r2 = f.slopes(geo, w, a, x, at, e, n)
                f1[i, j] = r1
                if wp.static(not f.is_scalar):
                    f2[i, j] = r2
        for i in range(np_):
            for j in range(np_):
                s1 = d1(geo.derivative, f1, i, j)
                s2 = d2(geo.derivative, f2, i, j)
                r = f.result(geo, winds[i, j], s1, s2, e, i * np_ + j)
                store(geo, x, r, k, e, i, j, out, done)

    return load_winds, sweep


def _store(t: KernelTypes, fields: int, finish: Finish) -> Any:
    """Return the function (geometry, x, result, k, e, i, j, out, done), from the k-th field on."""
    np_, last, rows, keep = t.np, t.np - 1, t.register.rows(fields), keep_fields(t, fields)

    @func
    def store(
        geo: t.geometry, x: t.vector, r: rows, k: int, e: int, i: int, j: int, out: t.local,
        done: t.done,
    ):  # fmt: skip
        n = i * np_ + j
        if wp.static(finish is None):
            keep(r, e, n, k, out)
        elif e < geo.whole and i > 0 and i < last and j > 0 and j < last:
            finish(geo, x, r, k, ~geo.nodes[e, n][0], done)
        else:
            keep(r, e, n, k, out)

    return store


def keep_fields(t: KernelTypes, fields: int) -> Any:
    """Return the function (result, e, n, k, out): the fields go to `out`, from the k-th on."""

    @func
    def keep(r: t.register.rows(fields), e: int, n: int, k: int, out: t.local):
        out[e, n, k] = r[0]
        if wp.static(fields > 1):
            out[e, n, k + 1] = r[1]
        if wp.static(fields > 2):
            out[e, n, k + 2] = r[2]

    return keep


def element_diffusion(t: KernelTypes, finish_of: Any = None) -> Any:
    """Return the function (geometry, x, e, out, done): the weak Laplacians in a group e.

    finish_of: makes a `Finish` for so many fields.
    """
    last = t.terms.unknowns - 1
    of_height = _laplacian(t, diffusion(t, True, False), last, finish_of and finish_of(1))
    of_wind = last and _laplacian(t, diffusion(t, False, True), 0, finish_of and finish_of(2))

    @func
    def diffuse(geo: t.geometry, x: t.vector, e: int, out: t.local, done: t.done):
        of_height(geo, x, e, out, done)
        if wp.static(last > 0):  # one after the other, for the sake of the first-level cache
            of_wind(geo, x, e, out, done)

    return diffuse


def _laplacian(t: KernelTypes, f: Formula, first: int, finish: Finish) -> Any:
    """Return the function (geometry, x, e, out, done) for the fields from the `first` on."""
    np_, rows, store = t.np, f.rows, _store(t, f.fields, finish)
    d1, d2, t1, t2 = line_sums(t.register, np_, rows)
    at_1, at_2, at_3, at_4, _ = scratch(np_, rows, rows, rows, rows)

    @func
    def laplacian(geo: t.geometry, x: t.vector, e: int, out: t.local, done: t.done):
        f1 = wp.array(ptr=geo.work + at_1, shape=(np_, np_), dtype=rows)
        f2 = f1
        if wp.static(not f.is_scalar):
            f2 = wp.array(ptr=geo.work + at_2, shape=(np_, np_), dtype=rows)
        g1 = wp.array(ptr=geo.work + at_3, shape=(np_, np_), dtype=rows)
        g2 = wp.array(ptr=geo.work + at_4, shape=(np_, np_), dtype=rows)
        for i in range(np_):
            for j in range(np_):
                n = i * np_ + j
                r1, r2 = f.slopes(geo, f.wind(geo, x, x, e, n), x, x, 0, e, n)
                f1[i, j] = r1
                if wp.static(not f.is_scalar):
                    f2[i, j] = r2
        for i in range(np_):
            for j in range(np_):
                s1 = d1(geo.derivative, f1, i, j)
                s2 = d2(geo.derivative, f2, i, j)
                r1, r2 = f.fluxes(geo, s1, s2, e, i * np_ + j)
                g1[i, j] = r1
                g2[i, j] = r2
        for i in range(np_):
            for j in range(np_):
                s1 = t1(geo.derivative, g1, i, j)
                s2 = t2(geo.derivative, g2, i, j)
                r = f.result(geo, s1, s2, e, i * np_ + j, out)
                store(geo, x, r, first, e, i, j, out, done)

    return laplacian


def element_kernel(t: KernelTypes, formula: Formula, finish: Finish = None) -> wp.Kernel:
    """Return the kernel (geometry, a, x, first, count, out, done) of a formula.

    It is for `count` fields of x from the offset `first` on; `done` is only used by `finish`.
    """
    load_winds, sweep = element_sweep(t, formula, finish, shared=True)

    @kernel
    def over_elements(
        geo: t.geometry, a: t.vector, x: t.vector, first: int, count: int, out: t.local,
        done: t.done,
    ):  # fmt: skip
        e = wp.tid()
        load_winds(geo, a, x, e)
        for k in range(count):
            sweep(geo, a, x, first + k * geo.size, k, e, out, done)

    return over_elements


def line_sums(register: Register, np_: int, rows: Any) -> tuple[Any, Any, Any, Any]:
    """Return derivatives of an element's rows along each coordinate (d1, d2), and transposes.

    They are Warp functions (derivative, field (np, np), i, j).
    """
    along, across = f"m * {np_} + j", f"i * {np_} + m"
    of = functools.partial(line_sum, register, np_, rows)
    return (
        of(f"i * {np_} + m", along),
        of(f"j * {np_} + m", across),
        of(f"m * {np_} + i", along),
        of(f"m * {np_} + j", across),
    )


def scratch(np_: int, *kinds: Any) -> list[Any]:
    """Return offsets [bytes] in a group's room for work arrays (np, np) of these types.

    Warp sets an array of a kernel's own to zero, and it would lie across cache lines.
    """
    sizes = [np_ * np_ * wp.types.type_size_in_bytes(kind) for kind in kinds]
    offsets = [sum(sizes[:i]) for i in range(len(sizes) + 1)]
    assert offsets[-1] <= room(np_)
    return [wp.uint64(offset) for offset in offsets]


def room(np_: int) -> int:
    """Return the bytes of this room: 16 registers a node."""
    return 16 * 64 * np_ * np_
