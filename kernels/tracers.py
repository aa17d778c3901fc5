"""Flux-form transport of tracer mass, in both launch shapes, and its pointwise companions.

A tracer with mixing ratio q has the mass hq a unit area, which the wind carries exactly as it
carries the depth h: the formulas and their order are those of the depth in `element.py` and
`node.py`, so that q = 1 has the tendency of h.  State vectors hold one block (N,) of hq a tracer,
the first of them at the offset `first`; all tracers are taken in one launch.
"""

import functools
from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.assembly import Contributors, gather_sum
from swe_sphere.kernels.element import line_sums
from swe_sphere.kernels.formulas import algebra
from swe_sphere.kernels.terms import kernel_types

OPTIONS = {"max_unroll": 1}


@functools.cache
def transport_kernels(np_: int, real: type, shape: str, prescribed: bool) -> SimpleNamespace:
    """Kernels `transport` and `tangent` for the mass-weighted -div(hq V) before DSS.

    transport: (geometry, wind (2N, ...), x, first, count, out); tangent: (geometry, base, x, first,
    count, out), the derivative at the state `base` along x, both with winds in front.  out has
    shape (groups, np*np, count); `shape` is "element" or "node".  `prescribed`: round as the depth
    does under a prescribed wind.
    """
    t = kernel_types(np_, real, shape)
    ops = algebra(t.value, t.index, real, t.lanes)
    flux_1, flux_2 = _fluxes(t, ops, prescribed)
    if shape == "element":
        line = line_sums(np_, t.value, real)
        transport = _element_transport(t, ops, line, flux_1, flux_2)
        tangent = _element_tangent(t, ops, line)
    else:
        transport, tangent = _node_transport(t, flux_1, flux_2), _node_tangent(t, ops)
    return SimpleNamespace(transport=transport, tangent=tangent, geometry=t.geometry, value=t.value)


def _fluxes(
    t: SimpleNamespace, ops: SimpleNamespace, prescribed: bool
) -> tuple[wp.Function, wp.Function]:
    """J times the contravariant components of m V, rounded as the kernels of the depth do it."""
    value, mul, wedge = t.value, ops.mul, ops.wedge

    @no_type_check
    @wp.func
    def flux_1(m: value, u: value, v: value, a21: value, a22: value):
        if wp.static(prescribed):
            return mul(m, wedge(u, v, a21, a22))
        else:
            return wedge(mul(m, u), mul(m, v), a21, a22)

    @no_type_check
    @wp.func
    def flux_2(m: value, u: value, v: value, a11: value, a12: value):
        if wp.static(prescribed):
            return mul(m, wedge(a11, a12, u, v))
        else:
            return wedge(a11, a12, mul(m, u), mul(m, v))

    return flux_1, flux_2


def _element_transport(
    t: SimpleNamespace,
    ops: SimpleNamespace,
    line: SimpleNamespace,
    flux_1: wp.Function,
    flux_2: wp.Function,
) -> wp.Kernel:
    np_, value, load, d1, d2 = t.np, t.value, ops.load, line.d1, line.d2

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def transport(
        geo: t.geometry, wind: t.vector, x: t.vector, first: int, count: int, out: t.local
    ):
        e = wp.tid()
        us = wp.zeros(shape=(np_, np_), dtype=value)
        vs = wp.zeros(shape=(np_, np_), dtype=value)
        f1 = wp.zeros(shape=(np_, np_), dtype=value)
        f2 = wp.zeros(shape=(np_, np_), dtype=value)
        for i in range(np_):
            for j in range(np_):
                us[i, j] = load(wind, 0, geo.nodes[e, i * np_ + j])
                vs[i, j] = load(wind, geo.size, geo.nodes[e, i * np_ + j])
        for k in range(count):
            for i in range(np_):
                for j in range(np_):
                    n = i * np_ + j
                    m = load(x, first + k * geo.size, geo.nodes[e, n])
                    u = us[i, j]
                    v = vs[i, j]
                    f1[i, j] = flux_1(m, u, v, geo.basis[e, n, 2], geo.basis[e, n, 3])
                    f2[i, j] = flux_2(m, u, v, geo.basis[e, n, 0], geo.basis[e, n, 1])
            for i in range(np_):
                for j in range(np_):
                    div = d1(geo.derivative, f1, i, j) + d2(geo.derivative, f2, i, j)
                    out[e, i * np_ + j, k] = -geo.weight[i, j] * div

    return transport


def _element_tangent(t: SimpleNamespace, ops: SimpleNamespace, line: SimpleNamespace) -> wp.Kernel:
    np_, value = t.np, t.value
    mul, load, wedge, d1, d2 = ops.mul, ops.load, ops.wedge, line.d1, line.d2

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def tangent(geo: t.geometry, base: t.vector, x: t.vector, first: int, count: int, out: t.local):
        e = wp.tid()
        f1 = wp.zeros(shape=(np_, np_), dtype=value)
        f2 = wp.zeros(shape=(np_, np_), dtype=value)
        for k in range(count):
            at = first + k * geo.size
            for i in range(np_):
                for j in range(np_):
                    n = i * np_ + j
                    node = geo.nodes[e, n]
                    m = load(x, at, node)
                    mb = load(base, at, node)
                    mu = mul(mb, load(x, 0, node)) + mul(m, load(base, 0, node))
                    mv = mul(mb, load(x, geo.size, node)) + mul(m, load(base, geo.size, node))
                    f1[i, j] = wedge(mu, mv, geo.basis[e, n, 2], geo.basis[e, n, 3])
                    f2[i, j] = wedge(geo.basis[e, n, 0], geo.basis[e, n, 1], mu, mv)
            for i in range(np_):
                for j in range(np_):
                    div = d1(geo.derivative, f1, i, j) + d2(geo.derivative, f2, i, j)
                    out[e, i * np_ + j, k] = -geo.weight[i, j] * div

    return tangent


def _node_transport(t: SimpleNamespace, flux_1: wp.Function, flux_2: wp.Function) -> wp.Kernel:
    np_, real = t.np, t.real

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def transport(
        geo: t.geometry, wind: t.vector, x: t.vector, first: int, count: int, out: t.local
    ):
        e, n = wp.tid()
        i = n // np_
        j = n % np_
        for k in range(count):
            at = first + k * geo.size
            div = real(0.0)
            for m in range(np_):
                p = m * np_ + j
                node = geo.nodes[e, p]
                u = wind[node]
                v = wind[geo.size + node]
                f = flux_1(x[at + node], u, v, geo.basis[e, p, 2], geo.basis[e, p, 3])
                div += geo.derivative[i, m] * f
                p = i * np_ + m
                node = geo.nodes[e, p]
                u = wind[node]
                v = wind[geo.size + node]
                f = flux_2(x[at + node], u, v, geo.basis[e, p, 0], geo.basis[e, p, 1])
                div += geo.derivative[j, m] * f
            out[e, n, k] = -geo.weight[i, j] * div

    return transport


def _node_tangent(t: SimpleNamespace, ops: SimpleNamespace) -> wp.Kernel:
    np_, real, wedge = t.np, t.real, ops.wedge

    @no_type_check
    @wp.func
    def momentum(geo: t.geometry, base: t.vector, x: t.vector, at: int, wind: int, node: int):
        return base[at + node] * x[wind + node] + x[at + node] * base[wind + node]

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def tangent(geo: t.geometry, base: t.vector, x: t.vector, first: int, count: int, out: t.local):
        e, n = wp.tid()
        i = n // np_
        j = n % np_
        for k in range(count):
            at = first + k * geo.size
            div = real(0.0)
            for m in range(np_):
                p = m * np_ + j
                node = geo.nodes[e, p]
                mu = momentum(geo, base, x, at, 0, node)
                mv = momentum(geo, base, x, at, geo.size, node)
                div += geo.derivative[i, m] * wedge(mu, mv, geo.basis[e, p, 2], geo.basis[e, p, 3])
                p = i * np_ + m
                node = geo.nodes[e, p]
                mu = momentum(geo, base, x, at, 0, node)
                mv = momentum(geo, base, x, at, geo.size, node)
                div += geo.derivative[j, m] * wedge(geo.basis[e, p, 0], geo.basis[e, p, 1], mu, mv)
            out[e, n, k] = -geo.weight[i, j] * div

    return tangent


@functools.cache
def blocks_kernel(real: type, adds: bool) -> wp.Kernel:
    """DSS of `count` fields from local ones into, or `adds` onto, the blocks from `first` on.

    Kernel over N threads: (places (N,), inverse_area (N,), stride, N, count, first, local, out).
    """
    vector = wp.array(dtype=real)
    gather = gather_sum(real)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def assemble(
        places: wp.array(dtype=Contributors),
        inverse_area: vector,
        stride: int,
        size: int,
        count: int,
        first: int,
        local: vector,
        out: vector,
    ):
        node = wp.tid()
        at = places[node]
        scale = inverse_area[node]
        for k in range(count):
            value = scale * gather(local, at, k * stride)
            if wp.static(adds):
                out[first + k * size + node] += value
            else:
                out[first + k * size + node] = value

    return assemble


@functools.cache
def pointwise_kernels(real: type) -> SimpleNamespace:
    """Algebra between tracers and depth, node by node; over (tracers, N) threads.

    `depth` and `first` are the offsets of the depth and of the first tracer in a state vector x.
    mixing_ratio: (x, depth, first, N, q (tracers*N,)): q = hq / h.
    follow: (r, x, q, depth, first, N): x_hq = r_hq + q (x_h - r_h).
    correct: (q, flux, air, factor, depth, first, N, r, x): x_hq = r_hq + q (x_h - r_h) +
    factor (flux - q air), air (N,) being the flux where q = 1.
    raised: (x, bottom, depth, first, N, out): out = hq (1 + b/h).
    raised_tangent: (base, bottom, depth, first, N, x, out): its derivative at `base` along x.
    scaled: (y, factor, first, N, x): x_hq = factor y.
    add: (y, first, N, x): x_hq += y.
    """
    vector = wp.array(dtype=real)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False)
    def mixing_ratio(x: vector, depth: int, first: int, size: int, q: vector):
        k, node = wp.tid()
        at = k * size + node
        q[at] = x[first + at] / x[depth + node]

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False)
    def follow(r: vector, x: vector, q: vector, depth: int, first: int, size: int):
        k, node = wp.tid()
        at = k * size + node
        x[first + at] = r[first + at] + q[at] * (x[depth + node] - r[depth + node])

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False)
    def correct(
        q: vector,
        flux: vector,
        air: vector,
        factor: real,
        depth: int,
        first: int,
        size: int,
        r: vector,
        x: vector,
    ):
        k, node = wp.tid()
        at = k * size + node
        change = q[at] * (x[depth + node] - r[depth + node])
        x[first + at] = r[first + at] + change + factor * (flux[at] - q[at] * air[node])

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False)
    def raised(x: vector, bottom: vector, depth: int, first: int, size: int, out: vector):
        k, node = wp.tid()
        at = k * size + node
        out[at] = x[first + at] * (real(1.0) + bottom[node] / x[depth + node])

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False)
    def raised_tangent(
        base: vector, bottom: vector, depth: int, first: int, size: int, x: vector, out: vector
    ):
        k, node = wp.tid()
        at = k * size + node
        h = base[depth + node]
        slope = bottom[node] / h
        lost = base[first + at] * slope / h * x[depth + node]
        out[at] = x[first + at] * (real(1.0) + slope) - lost

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False)
    def scaled(y: vector, factor: real, first: int, size: int, x: vector):
        k, node = wp.tid()
        at = k * size + node
        x[first + at] = factor * y[at]

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False)
    def add(y: vector, first: int, size: int, x: vector):
        k, node = wp.tid()
        at = k * size + node
        x[first + at] += y[at]

    return SimpleNamespace(
        mixing_ratio=mixing_ratio,
        follow=follow,
        correct=correct,
        raised=raised,
        raised_tangent=raised_tangent,
        scaled=scaled,
        add=add,
    )
