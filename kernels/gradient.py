"""Gradient and divergence alone, in both launch shapes, with the nodal steps of a Helmholtz solve.

The tendencies before DSS are those of `element.py` and `node.py` for one field or two; the assembly
kernels fuse DSS with the pointwise algebra that follows it.
"""

import functools
from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.element import line_sums
from swe_sphere.kernels.formulas import algebra
from swe_sphere.kernels.terms import kernel_types

OPTIONS = {"max_unroll": 1}


@functools.cache
def derivative_kernels(np_: int, real: type, shape: str) -> SimpleNamespace:
    """Kernels `gradient` (geometry, s, out) and `divergence` (geometry, V, out), before DSS.

    s has shape (N,), V (2N,), out (groups, np*np, 2 or 1); the structure `geometry` holds `nodes`,
    `basis`, `derivative`, `weight` and `size` as in the tendency kernels; `shape` is "element" or
    "node".
    """
    t = kernel_types(np_, real, shape)
    ops = algebra(t.value, t.index, real, t.lanes)
    if shape == "element":
        line = line_sums(np_, t.value, real)
        gradient, divergence = _element_gradient(t, ops, line), _element_divergence(t, ops, line)
    else:
        gradient, divergence = _node_gradient(t, ops), _node_divergence(t, ops)
    return SimpleNamespace(
        gradient=gradient, divergence=divergence, geometry=t.geometry, value=t.value
    )


def _element_gradient(t: SimpleNamespace, ops: SimpleNamespace, line: SimpleNamespace) -> wp.Kernel:
    np_, value = t.np, t.value
    load, wedge, d1, d2 = ops.load, ops.wedge, line.d1, line.d2

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def gradient(geo: t.geometry, s: t.vector, out: t.local):
        e = wp.tid()
        f = wp.zeros(shape=(np_, np_), dtype=value)
        for i in range(np_):
            for j in range(np_):
                f[i, j] = load(s, 0, geo.nodes[e, i * np_ + j])
        for i in range(np_):
            for j in range(np_):
                n = i * np_ + j
                w = geo.weight[i, j]
                f1 = d1(geo.derivative, f, i, j)
                f2 = d2(geo.derivative, f, i, j)
                out[e, n, 0] = w * wedge(f1, f2, geo.basis[e, n, 1], geo.basis[e, n, 3])
                out[e, n, 1] = w * wedge(geo.basis[e, n, 0], geo.basis[e, n, 2], f1, f2)

    return gradient


def _element_divergence(
    t: SimpleNamespace, ops: SimpleNamespace, line: SimpleNamespace
) -> wp.Kernel:
    np_, value = t.np, t.value
    load, wedge, d1, d2 = ops.load, ops.wedge, line.d1, line.d2

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def divergence(geo: t.geometry, wind: t.vector, out: t.local):
        e = wp.tid()
        f1 = wp.zeros(shape=(np_, np_), dtype=value)
        f2 = wp.zeros(shape=(np_, np_), dtype=value)
        for i in range(np_):
            for j in range(np_):
                n = i * np_ + j
                node = geo.nodes[e, n]
                u = load(wind, 0, node)
                v = load(wind, geo.size, node)
                f1[i, j] = wedge(u, v, geo.basis[e, n, 2], geo.basis[e, n, 3])
                f2[i, j] = wedge(geo.basis[e, n, 0], geo.basis[e, n, 1], u, v)
        for i in range(np_):
            for j in range(np_):
                d = d1(geo.derivative, f1, i, j) + d2(geo.derivative, f2, i, j)
                out[e, i * np_ + j, 0] = geo.weight[i, j] * d

    return divergence


def _node_gradient(t: SimpleNamespace, ops: SimpleNamespace) -> wp.Kernel:
    np_, real, wedge = t.np, t.real, ops.wedge

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def gradient(geo: t.geometry, s: t.vector, out: t.local):
        e, n = wp.tid()
        i = n // np_
        j = n % np_
        f1 = real(0.0)
        f2 = real(0.0)
        for m in range(np_):
            f1 += geo.derivative[i, m] * s[geo.nodes[e, m * np_ + j]]
            f2 += geo.derivative[j, m] * s[geo.nodes[e, i * np_ + m]]
        w = geo.weight[i, j]
        out[e, n, 0] = w * wedge(f1, f2, geo.basis[e, n, 1], geo.basis[e, n, 3])
        out[e, n, 1] = w * wedge(geo.basis[e, n, 0], geo.basis[e, n, 2], f1, f2)

    return gradient


def _node_divergence(t: SimpleNamespace, ops: SimpleNamespace) -> wp.Kernel:
    np_, real, wedge = t.np, t.real, ops.wedge

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def divergence(geo: t.geometry, wind: t.vector, out: t.local):
        e, n = wp.tid()
        i = n // np_
        j = n % np_
        div = real(0.0)
        for m in range(np_):
            p = m * np_ + j
            node = geo.nodes[e, p]
            u = wind[node]
            v = wind[geo.size + node]
            div += geo.derivative[i, m] * wedge(u, v, geo.basis[e, p, 2], geo.basis[e, p, 3])
            p = i * np_ + m
            node = geo.nodes[e, p]
            u = wind[node]
            v = wind[geo.size + node]
            div += geo.derivative[j, m] * wedge(geo.basis[e, p, 0], geo.basis[e, p, 1], u, v)
        out[e, n, 0] = geo.weight[i, j] * div

    return divergence
