"""Block elimination of the linearised equations, on fields that every element has for itself.

With tau the implicit step, T = (I + tau f k x)^-1 and the depth H, elimination of the wind leaves
S = I - tau^2 g D H T G for the depth, with the discrete, DSS'd gradient G and divergence D.

A field has a node once in each element that holds it, (groups + 1, np*np, 1), so that kernels read
whole SIMD registers.  What an element leaves for DSS has the same shape, and DSS is made where it
is read next: to the own contribution come those of `others` (groups, np*np, 3), one on an edge of
the element and three at a corner.  One that is not there stands in the last group, which is zero.
"""

import functools
from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.access import address_of, converting_load, entry_of, gather_run, put_of
from swe_sphere.kernels.assembly import OPTIONS, Contributors
from swe_sphere.kernels.element import line_sums
from swe_sphere.kernels.terms import kernel_types


@functools.cache
def elimination_kernels(np_: int, real: type, given: type, shape: str) -> SimpleNamespace:
    """Kernels on fields of `real`, of which some read or write state vectors (3N,) of `given`.

    Those on elements take a `geometry` and are launched over (groups, np*np / `share`) threads;
    `substituted` is launched over the N nodes.  Where `together`, fluxes stand in one row of f1 and
    f2, in the nearest cache, and a thread takes their divergence too; else that is a kernel.
    """
    t = kernel_types(np_, real, shape, whole=False)
    value, field, on_nodes, state = t.value, t.local, wp.array(dtype=real), wp.array(dtype=given)
    mul, dot, wedge = t.ops.mul, t.ops.dot, t.ops.wedge
    share, together = (np_ * np_, True) if shape == "element" else (1, False)
    members = {
        "nodes": wp.array2d(dtype=t.index),
        "others": wp.array3d(dtype=t.index),
        "basis": wp.array3d(dtype=value),
        "derivative": wp.array2d(dtype=real),
        "weight": wp.array2d(dtype=real),
        "per_area": wp.array2d(dtype=value),
        "fluxes": wp.array3d(dtype=value),
        "per_diagonal": wp.array2d(dtype=value),
        "size": wp.int32,
    }
    geometry = wp.struct(type("Geometry", (), {"__annotations__": members}))
    assembled, load = _assembled(t, geometry), load_state(t, given)

    along, across = line_sums(t, value)[:2]
    address = address_of(value)

    @no_type_check
    @wp.func
    def derivatives(geo: geometry, a: field, b: field, e: int, n: int):
        """Of a and b, along each coordinate."""
        at = e * np_ * np_
        on_1 = wp.array(ptr=address(a, at), shape=(np_, np_), dtype=value)
        on_2 = wp.array(ptr=address(b, at), shape=(np_, np_), dtype=value)
        i = n // np_
        j = n % np_
        return along(geo.derivative, on_1, i, j), across(geo.derivative, on_2, i, j)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def gradient(geo: geometry, x: field, east: field, north: field):
        e, part = wp.tid()
        for n in range(part * share, part * share + share):
            w = geo.weight[n // np_, n % np_]
            s1, s2 = derivatives(geo, x, x, e, n)
            east[e, n, 0] = w * wedge(s1, s2, geo.basis[e, n, 1], geo.basis[e, n, 3])
            north[e, n, 0] = w * wedge(geo.basis[e, n, 0], geo.basis[e, n, 2], s1, s2)

    @no_type_check
    @wp.func
    def diverge(geo: geometry, f1: field, f2: field, row: int, e: int, n: int, out: field):
        s1, s2 = derivatives(geo, f1, f2, row, n)
        out[e, n, 0] = geo.weight[n // np_, n % np_] * (s1 + s2)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def divergence(geo: geometry, f1: field, f2: field, out: field):
        e, n = wp.tid()
        diverge(geo, f1, f2, e, e, n, out)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def wind_fluxes(geo: geometry, r: state, f1: field, f2: field, out: field):
        e, part = wp.tid()
        row = wp.where(together, 0, e)
        for n in range(part * share, part * share + share):
            u = load(r, 0, geo.nodes[e, n])
            v = load(r, geo.size, geo.nodes[e, n])
            f1[row, n, 0] = dot(geo.fluxes[e, n, 0], geo.fluxes[e, n, 1], u, v)
            f2[row, n, 0] = dot(geo.fluxes[e, n, 2], geo.fluxes[e, n, 3], u, v)
        if wp.static(together):
            for n in range(share):
                diverge(geo, f1, f2, row, e, n, out)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def slope_fluxes(
        geo: geometry,
        east: field,
        east_flat: on_nodes,
        north: field,
        north_flat: on_nodes,
        f1: field,
        f2: field,
        out: field,
    ):
        e, part = wp.tid()
        row = wp.where(together, 0, e)
        for n in range(part * share, part * share + share):
            u = mul(geo.per_area[e, n], assembled(geo, east, east_flat, e, n))
            v = mul(geo.per_area[e, n], assembled(geo, north, north_flat, e, n))
            f1[row, n, 0] = dot(geo.fluxes[e, n, 0], geo.fluxes[e, n, 1], u, v)
            f2[row, n, 0] = dot(geo.fluxes[e, n, 2], geo.fluxes[e, n, 3], u, v)
        if wp.static(together):
            for n in range(share):
                diverge(geo, f1, f2, row, e, n, out)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def eliminated(geo: geometry, local: field, flat: on_nodes, r: state, tau: real, b: field):
        e, part = wp.tid()
        for n in range(part * share, part * share + share):
            inflow = mul(geo.per_area[e, n], assembled(geo, local, flat, e, n))
            b[e, n, 0] = load(r, 2 * geo.size, geo.nodes[e, n]) - tau * inflow

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def chebyshev(
        geo: geometry,
        local: field,
        flat: on_nodes,
        sign: real,
        tau_tau_g: real,
        keep: real,
        take: real,
        beta: real,
        r: field,
        d: field,
        x: field,
    ):
        e, part = wp.tid()
        for n in range(part * share, part * share + share):
            second = mul(geo.per_area[e, n], assembled(geo, local, flat, e, n))
            residual = r[e, n, 0] + sign * (d[e, n, 0] - tau_tau_g * second)
            step = keep * d[e, n, 0] + take * mul(geo.per_diagonal[e, n], residual)
            r[e, n, 0] = residual
            d[e, n, 0] = step
            x[e, n, 0] = x[e, n, 0] + beta * step

    gather, places = gather_run(real, Contributors, real, 1), wp.array(dtype=Contributors)
    numbers, number = wp.array(dtype=wp.int32), entry_of(wp.int32)
    entry, given_entry, put = entry_of(real), entry_of(given), put_of(given)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def substituted(
        places_1: places,
        of_own: numbers,
        inverse_area: on_nodes,
        same: on_nodes,
        cross: on_nodes,
        size: int,
        east: on_nodes,
        north: on_nodes,
        h: on_nodes,
        r: state,
        tau_g: real,
        out: state,
    ):
        node = wp.tid()
        scale = tau_g * entry(inverse_area, node)
        u = real(given_entry(r, node)) - scale * gather(east, places_1, node, 0)
        v = real(given_entry(r, size + node)) - scale * gather(north, places_1, node, 0)
        s = entry(same, node)
        c = entry(cross, node)
        put(out, node, given(s * u + c * v))
        put(out, size + node, given(s * v - c * u))
        put(out, 2 * size + node, given(entry(h, number(of_own, node))))

    return SimpleNamespace(
        gradient=gradient,
        divergence=divergence,
        wind_fluxes=wind_fluxes,
        slope_fluxes=slope_fluxes,
        eliminated=eliminated,
        chebyshev=chebyshev,
        substituted=substituted,
        geometry=geometry,
        value=value,
        share=share,
        together=together,
    )


def _assembled(t: SimpleNamespace, geometry: type) -> wp.Function:
    """Function (geometry, local, flat, e, n): DSS of what elements left, at one of their nodes."""
    np_, load = t.np, t.ops.load

    @no_type_check
    @wp.func
    def assembled(geo: geometry, local: t.local, flat: t.vector, e: int, n: int):
        total = local[e, n, 0]
        on_1 = (n // np_) % (np_ - 1) == 0
        on_2 = (n % np_) % (np_ - 1) == 0
        if on_1 or on_2:
            total += load(flat, 0, geo.others[e, n, 0])
        if on_1 and on_2:
            total += load(flat, 0, geo.others[e, n, 1]) + load(flat, 0, geo.others[e, n, 2])
        return total

    return assembled


def load_state(t: SimpleNamespace, given: type) -> wp.Function:
    """Function (x, offset, nodes): numbers of a vector of `given`, as those of the fields."""
    if given is t.real:
        return t.ops.load
    return converting_load(t.value, t.index, given, t.real, t.lanes)


@functools.cache
def passage_kernels(np_: int, real: type, given: type, shape: str) -> SimpleNamespace:
    """`spread` of a nodal vector (N,) of `given` to a field, and `collect` of it from there."""
    t = kernel_types(np_, real, shape, whole=False)
    load, share = load_state(t, given), np_ * np_ if shape == "element" else 1
    vector, field, nodes, places = (
        wp.array(dtype=given), t.local, wp.array2d(dtype=t.index), wp.array(dtype=wp.int32)
    )  # fmt: skip

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def spread(node: nodes, x: vector, out: field):
        e, part = wp.tid()
        for n in range(part * share, part * share + share):
            out[e, n, 0] = load(x, 0, node[e, n])

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def collect(of_own: places, flat: wp.array(dtype=real), out: vector):
        node = wp.tid()
        out[node] = given(flat[of_own[node]])

    return SimpleNamespace(spread=spread, collect=collect)
