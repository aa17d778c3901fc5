"""One thread a group of elements: the launch shape for CPUs.

Each SIMD lane holds one element, so that every product of the tensor derivative is one instruction
for `lanes` elements; the work arrays of a group stay in the first-level cache.
"""

import functools
from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.access import scratch
from swe_sphere.kernels.assembly import OPTIONS
from swe_sphere.kernels.diffusion import Diffusion, diffusion
from swe_sphere.kernels.dynamics import mass_flux
from swe_sphere.kernels.formulas import Formula, keep_fields
from swe_sphere.kernels.forward_backward import finish_wind
from swe_sphere.kernels.registers import line_sum
from swe_sphere.kernels.stages import leave_of


def element_sweep(t: SimpleNamespace, f: Formula) -> wp.Function:
    """Function (geometry, a, x, at, e, 0, k, out, done): the formula at all nodes of a group e.

    Where `direct`, nodes inside the elements, which need no DSS, go to `done` finished.
    """
    np_, real, geometry, vector, local = t.np, t.real, t.geometry, t.vector, t.local
    rows, kept, (d1, d2, _, _) = f.rows, f.winds, line_sums(t, f.rows)
    keep, deliver = keep_fields(t, f), _deliver(t, f) if t.direct else None
    at_1, at_2, at_winds, _ = scratch(np_, rows, rows, kept)

    @no_type_check
    @wp.func
    def sweep(
        geo: geometry,
        a: vector,
        x: vector,
        at: int,
        e: int,
        n: int,
        k: int,
        out: local,
        done: t.done,
    ):
        f1 = wp.array(ptr=geo.work + at_1, shape=(np_, np_), dtype=rows)
        f2 = wp.array(ptr=geo.work + at_2, shape=(np_, np_), dtype=rows)
        if wp.static(f.stored):
            winds = wp.array(ptr=geo.work + at_winds, shape=(np_, np_), dtype=kept)
        for i in range(np_):
            for j in range(np_):
                p = i * np_ + j
                w = f.wind(geo, a, x, e, p)
                point = f.read(geo, w, a, x, at, e, p)
                f1[i, j] = f.first(geo, point, e, p)
                f2[i, j] = f.second(geo, point, e, p)
                if wp.static(f.stored):
                    winds[i, j] = w
        for i in range(np_):
            for j in range(np_):
                p = i * np_ + j
                if wp.static(f.stored):
                    w = winds[i, j]
                elif wp.static(f.turns or kept is real):
                    w = f.wind(geo, a, x, e, p)
                else:
                    w = kept()
                s1 = d1(geo.derivative, f1, i, j)
                s2 = d2(geo.derivative, f2, i, j)
                r = f.result(geo, w, s1, s2, e, p)
                if wp.static(t.direct and t.terms.poisson):
                    deliver(geo, a, w, r, e, i, j, out, done)
                elif wp.static(t.direct):
                    deliver(geo, x, w, r, e, i, j, out, done)
                else:
                    keep(r, e, p, k, out)

    return sweep


def _deliver(t: SimpleNamespace, f: Formula, first: int = 0) -> wp.Function:
    """Function (geometry, x, winds, result, e, i, j, out, done): to where that node has it.

    first: the field that the result begins with.  x: the state, as pointwise terms take it.
    """
    np_, last, keep = t.np, t.np - 1, keep_fields(t, f)
    rates = t.done is t.vector
    finish = _finish(t, f, first) if rates else finish_wind(t)

    @no_type_check
    @wp.func
    def deliver(
        geo: t.geometry,
        x: t.vector,
        w: f.winds,
        r: t.rows(f.fields),
        e: int,
        i: int,
        j: int,
        out: t.local,
        done: t.done,
    ):
        n = i * np_ + j
        if e < geo.whole and i > 0 and i < last and j > 0 and j < last:
            if wp.static(rates):
                finish(geo, x, r, geo.nodes[e, n], done)
            else:
                finish(geo, r, ~geo.nodes[e, n][0], done)
        else:
            keep(r, e, n, first, out)

    return deliver


def _finish(t: SimpleNamespace, f: Formula, first: int) -> wp.Function:
    """Function (geometry, x, result, node, done): what DSS makes of a run of inner nodes."""
    mul, load, add = t.ops.mul, t.ops.load_run, t.point.add
    rates, fields = t.rows(f.fields), f.fields
    leave = leave_of(rates, t.real, t.lanes, fields)

    @no_type_check
    @wp.func
    def finish(geo: t.geometry, x: t.vector, r: rates, node: t.index, done: t.vector):
        scale = load(geo.inverse_area, 0, node)
        rate = r
        if wp.static(fields == 1):
            rate = mul(scale, r)
        else:
            for k in range(wp.static(fields)):
                rate[k] = mul(scale, r[k])
        if wp.static(fields == t.terms.unknowns):
            rate = add(geo.point, ~node[0], geo.size, x, rate)
        leave(geo.stage, ~node[0] + first * geo.size, geo.size, rate, done)

    return finish


def element_diffusion(t: SimpleNamespace) -> wp.Function:
    """Function (geometry, x, e, 0, out, done): the weak Laplacians at all nodes of a group e."""
    last = t.terms.unknowns - 1
    of_height = _laplacian(t, diffusion(t, height=True, wind=False), last)
    of_wind = _laplacian(t, diffusion(t, height=False, wind=True), 0) if last else None

    @no_type_check
    @wp.func
    def diffuse(geo: t.geometry, x: t.vector, e: int, n: int, out: t.local, done: t.done):
        of_height(geo, x, e, out, done)
        if wp.static(last > 0):  # one after the other, for the sake of the first-level cache
            of_wind(geo, x, e, out, done)

    return diffuse


def _laplacian(t: SimpleNamespace, of: Diffusion, first: int) -> wp.Function:
    """Function (geometry, x, e, out, done): of one or two fields, the `first` and the next."""
    f, np_, real = of.formula, t.np, t.real
    rows, (d1, d2, t1, t2) = f.rows, line_sums(t, f.rows)
    at_1, at_2, at_3, at_4, _ = scratch(np_, rows, rows, rows, rows)
    keep, deliver = keep_fields(t, f), _deliver(t, f, first) if t.direct else None

    @no_type_check
    @wp.func
    def laplacian(geo: t.geometry, x: t.vector, e: int, out: t.local, done: t.done):
        f1 = wp.array(ptr=geo.work + at_1, shape=(np_, np_), dtype=rows)
        if wp.static(f.second is not f.first):
            f2 = wp.array(ptr=geo.work + at_2, shape=(np_, np_), dtype=rows)
        g1 = wp.array(ptr=geo.work + at_3, shape=(np_, np_), dtype=rows)
        g2 = wp.array(ptr=geo.work + at_4, shape=(np_, np_), dtype=rows)
        for i in range(np_):
            for j in range(np_):
                p = i * np_ + j
                point = f.read(geo, f.wind(geo, x, x, e, p), x, x, 0, e, p)
                f1[i, j] = f.first(geo, point, e, p)
                if wp.static(f.second is not f.first):
                    f2[i, j] = f.second(geo, point, e, p)
        for i in range(np_):
            for j in range(np_):
                s1 = d1(geo.derivative, f1, i, j)
                if wp.static(f.second is f.first):
                    s2 = d2(geo.derivative, f1, i, j)
                else:
                    s2 = d2(geo.derivative, f2, i, j)
                r1, r2 = of.fluxes(geo, s1, s2, e, i * np_ + j)
                g1[i, j] = r1
                g2[i, j] = r2
        for i in range(np_):
            for j in range(np_):
                s1 = t1(geo.derivative, g1, i, j)
                s2 = t2(geo.derivative, g2, i, j)
                r = of.result(geo, s1, s2, e, i * np_ + j, out)
                if wp.static(t.direct):
                    deliver(geo, x, real(0.0), r, e, i, j, out, done)
                else:
                    keep(r, e, i * np_ + j, first, out)

    return laplacian


def element_gradient(t: SimpleNamespace) -> wp.Kernel:
    """Kernel (geometry, a, x, first, count, out): gradient of the field in front of x, a unused.

    What `element_sweep` makes of the formula of the gradient takes 1.15 to 1.4 times as long.
    """
    np_, value, (d1, d2, _, _) = t.np, t.value, line_sums(t, t.value)
    geometry, vector, local, load, wedge = t.geometry, t.vector, t.local, t.ops.load, t.ops.wedge

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def over_elements(geo: geometry, a: vector, x: vector, first: int, count: int, out: local):
        e = wp.tid()
        f = wp.array(ptr=geo.work, shape=(np_, np_), dtype=value)
        for i in range(np_):
            for j in range(np_):
                f[i, j] = load(x, 0, geo.nodes[e, i * np_ + j])
        for i in range(np_):
            for j in range(np_):
                n = i * np_ + j
                w = geo.weight[i, j]
                s1 = d1(geo.derivative, f, i, j)
                s2 = d2(geo.derivative, f, i, j)
                out[e, n, 0] = w * wedge(s1, s2, geo.basis[e, n, 1], geo.basis[e, n, 3])
                out[e, n, 1] = w * wedge(geo.basis[e, n, 0], geo.basis[e, n, 2], s1, s2)

    return over_elements


def element_divergence(t: SimpleNamespace, kind: str) -> wp.Kernel:
    """Kernel (geometry, a, x, first, count, out): the formula `transport` of that kind.

    For the same reason, with the winds of an element loaded once for all masses they carry.
    """
    np_, value, (d1, d2, _, _) = t.np, t.value, line_sums(t, t.value)
    geometry, vector, local, load, wedge = t.geometry, t.vector, t.local, t.ops.load, t.ops.wedge
    mass, flux = kind == "mass", mass_flux(t, kind == "tangent")
    field, (_, at_2, at_3, at_4, _) = wp.array2d(dtype=value), scratch(np_, *4 * (value,))

    @no_type_check
    @wp.func
    def fill(geo: geometry, a: vector, e: int, us: field, vs: field):
        for i in range(np_):
            for j in range(np_):
                us[i, j] = load(a, 0, geo.nodes[e, i * np_ + j])
                vs[i, j] = load(a, geo.size, geo.nodes[e, i * np_ + j])

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def over_elements(geo: geometry, a: vector, x: vector, first: int, count: int, out: local):
        e = wp.tid()
        f1 = wp.array(ptr=geo.work, shape=(np_, np_), dtype=value)
        f2 = wp.array(ptr=geo.work + at_2, shape=(np_, np_), dtype=value)
        if wp.static(mass):
            us = wp.array(ptr=geo.work + at_3, shape=(np_, np_), dtype=value)
            vs = wp.array(ptr=geo.work + at_4, shape=(np_, np_), dtype=value)
            fill(geo, a, e, us, vs)
        for k in range(count):
            for i in range(np_):
                for j in range(np_):
                    n = i * np_ + j
                    node = geo.nodes[e, n]
                    m = load(x, first + k * geo.size, node)
                    if wp.static(mass):
                        u = us[i, j]
                        v = vs[i, j]
                        fu, fv = flux(u, v, m, u, v, m)
                    else:
                        mb = load(a, first + k * geo.size, node)
                        u = load(x, 0, node)
                        v = load(x, geo.size, node)
                        fu, fv = flux(u, v, m, load(a, 0, node), load(a, geo.size, node), mb)
                    f1[i, j] = wedge(fu, fv, geo.basis[e, n, 2], geo.basis[e, n, 3])
                    f2[i, j] = wedge(geo.basis[e, n, 0], geo.basis[e, n, 1], fu, fv)
            for i in range(np_):
                for j in range(np_):
                    div = d1(geo.derivative, f1, i, j) + d2(geo.derivative, f2, i, j)
                    out[e, i * np_ + j, k] = -geo.weight[i, j] * div

    return over_elements


def line_sums(t: SimpleNamespace, rows: type) -> tuple[wp.Function, ...]:
    """Derivatives of an element's rows along each coordinate (d1, d2), and transposes (t1, t2)."""
    along, across = f"m * {t.np} + j", f"i * {t.np} + m"
    of = functools.partial(line_sum, rows, t.real, t.lanes, t.np)
    return (
        of(f"i * {t.np} + m", along),
        of(f"j * {t.np} + m", across),
        of(f"m * {t.np} + i", along),
        of(f"m * {t.np} + j", across),
    )
