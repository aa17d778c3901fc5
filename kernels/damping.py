"""Damping of each element's own modes: a cheap stand-in for the inverse of implicit diffusion."""

import functools
from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.access import gather_run
from swe_sphere.kernels.assembly import OPTIONS, Contributors
from swe_sphere.kernels.helmholtz import load_state
from swe_sphere.kernels.terms import kernel_types


@functools.cache
def damping_kernels(np_: int, real: type, given: type, shape: str) -> SimpleNamespace:
    """`damp`, over the groups: multiplies the modes of an element by `factor` (groups, np*np).

    `to_modes` and `to_nodes` (np, np) act along one coordinate; the result is multiplied by `scale`
    (groups, np*np).  `covariant`, over (groups, np*np / `share`): covariant components of the wind
    of a state; `physical` makes of those the wind again, with the weights of DSS, which `joined`,
    over the N nodes, completes for one field.
    """
    t = kernel_types(np_, real, shape)
    value, field, on_nodes, state = t.value, t.local, wp.array(dtype=real), wp.array(dtype=given)
    share, mul, dot, wedge = 1, t.ops.mul, t.ops.dot, t.ops.wedge
    if shape == "element":
        share = np_ * np_
    matrix, each, load = wp.array2d(dtype=real), wp.array2d(dtype=value), load_state(t, given)
    gather = gather_run(real, Contributors, real, 1)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def damp(to_modes: matrix, to_nodes: matrix, factor: each, scale: each, x: field, out: field):
        e = wp.tid()
        a = wp.zeros(shape=(np_, np_), dtype=value)
        b = wp.zeros(shape=(np_, np_), dtype=value)
        for k in range(np_):
            for j in range(np_):
                total = value(real(0.0))
                for i in range(np_):
                    total += to_modes[k, i] * x[e, i * np_ + j, 0]
                a[k, j] = total
        for k in range(np_):
            for m in range(np_):
                total = value(real(0.0))
                for j in range(np_):
                    total += to_modes[m, j] * a[k, j]
                b[k, m] = mul(factor[e, k * np_ + m], total)
        for i in range(np_):
            for m in range(np_):
                total = value(real(0.0))
                for k in range(np_):
                    total += to_nodes[i, k] * b[k, m]
                a[i, m] = total
        for i in range(np_):
            for j in range(np_):
                total = value(real(0.0))
                for m in range(np_):
                    total += to_nodes[j, m] * a[i, m]
                out[e, i * np_ + j, 0] = mul(scale[e, i * np_ + j], total)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def covariant(
        nodes: wp.array2d(dtype=t.index),
        basis: wp.array3d(dtype=value),
        size: int,
        r: state,
        first: field,
        second: field,
    ):
        e, part = wp.tid()
        for n in range(part * share, part * share + share):
            u = load(r, 0, nodes[e, n])
            v = load(r, size, nodes[e, n])
            first[e, n, 0] = dot(basis[e, n, 0], basis[e, n, 1], u, v)
            second[e, n, 0] = dot(basis[e, n, 2], basis[e, n, 3], u, v)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def physical(
        weight: matrix,
        basis: wp.array3d(dtype=value),
        first: field,
        second: field,
        east: field,
        north: field,
    ):
        e, part = wp.tid()
        for n in range(part * share, part * share + share):
            w = weight[n // np_, n % np_]
            s1 = first[e, n, 0]
            s2 = second[e, n, 0]
            east[e, n, 0] = w * wedge(s1, s2, basis[e, n, 1], basis[e, n, 3])
            north[e, n, 0] = w * wedge(basis[e, n, 0], basis[e, n, 2], s1, s2)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def joined(
        places_1: wp.array(dtype=Contributors),
        inverse_area: on_nodes,
        local: on_nodes,
        first: int,
        out: state,
    ):
        node = wp.tid()
        out[first + node] = given(inverse_area[node] * gather(local, places_1, node, 0))

    return SimpleNamespace(
        damp=damp, covariant=covariant, physical=physical, joined=joined, share=share
    )
