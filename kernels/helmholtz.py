"""Block elimination of the linearised equations, on fields that every element has for itself.

With tau the implicit step, T = (I + tau f k x)^-1 and the depth H, elimination of the wind leaves
S = I - tau^2 g D H T G for the depth, with the discrete, DSS'd gradient G and divergence D.

A field has a node once in each element that holds it, (groups + 1, np*np, 1), so that kernels read
whole SIMD registers.  What an element leaves for DSS has the same shape, and DSS is made where it
is read next: to the own contribution come those of `others` (groups, np*np, 3), one on an edge of
the element and three at a corner.  One that is not there stands in the last group, which is zero.
"""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from swe_sphere.kernels.define import func, kernel, struct_of
from swe_sphere.kernels.element import line_sums
from swe_sphere.kernels.simd.memory import (
    Contributors,
    address_of,
    entry_of,
    gather_of,
    load_of,
    put_of,
)
from swe_sphere.kernels.simd.register import Register
from swe_sphere.kernels.terms import KernelTypes


@dataclass(frozen=True)
class EliminationKernels:
    """Kernels on fields, of which some read or write state vectors (3N,) of another number type.

    The kernels on elements take a `geometry` and are launched over (groups, np*np / `share`)
    threads; `substituted` is launched over the N nodes.
    """

    gradient: wp.Kernel
    divergence: wp.Kernel
    wind_fluxes: wp.Kernel
    slope_fluxes: wp.Kernel
    eliminated: wp.Kernel
    chebyshev: wp.Kernel
    substituted: wp.Kernel
    geometry: Any
    value: Any
    share: int
    together: bool
    """True where fluxes stand in one row of f1 and f2, in the nearest cache.  A thread then takes
    their divergence too; otherwise `divergence` does."""


@functools.cache
def elimination_kernels(np_: int, real: Any, given: Any, shape: str) -> EliminationKernels:
    """Return the kernels for fields of `real` and states of `given`."""
    t = KernelTypes(np_, real, shape, whole=False)
    value, field, on_nodes, state = t.value, t.local, wp.array(dtype=real), wp.array(dtype=given)
    mul, dot, grad, div = t.metric.mul, t.metric.dot, t.metric.gradient, t.metric.divergence
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
    geometry, address = struct_of("Geometry", members), address_of(value)
    assembled, load = _assembled(t, geometry), load_of(t.register, given)
    along, across, _, _ = line_sums(t.register, np_, value)

    @func
    def derivatives(geo: geometry, a: field, b: field, e: int, n: int):
        """Return those of a along the first coordinate and of b along the second."""
        at = e * np_ * np_
        on_1 = wp.array(ptr=address(a, at), shape=(np_, np_), dtype=value)
        on_2 = wp.array(ptr=address(b, at), shape=(np_, np_), dtype=value)
        i = n // np_
        j = n % np_
        return along(geo.derivative, on_1, i, j), across(geo.derivative, on_2, i, j)

    @kernel
    def gradient(geo: geometry, x: field, east: field, north: field):
        e, part = wp.tid()
        for n in range(part * share, part * share + share):
            w = geo.weight[n // np_, n % np_]
            s1, s2 = derivatives(geo, x, x, e, n)
            g1, g2 = grad(geo.basis, e, n, s1, s2)
            east[e, n, 0] = w * g1
            north[e, n, 0] = w * g2

    @func
    def diverge(geo: geometry, f1: field, f2: field, row: int, e: int, n: int, out: field):
        s1, s2 = derivatives(geo, f1, f2, row, n)
        out[e, n, 0] = geo.weight[n // np_, n % np_] * div(s1, s2)

    @kernel
    def divergence(geo: geometry, f1: field, f2: field, out: field):
        e, n = wp.tid()
        diverge(geo, f1, f2, e, e, n, out)

    @func
    def put_fluxes(
        geo: geometry, u: value, v: value, row: int, e: int, n: int, f1: field, f2: field
    ):
        f1[row, n, 0] = dot(geo.fluxes[e, n, 0], geo.fluxes[e, n, 1], u, v)
        f2[row, n, 0] = dot(geo.fluxes[e, n, 2], geo.fluxes[e, n, 3], u, v)

    @kernel
    def wind_fluxes(geo: geometry, r: state, f1: field, f2: field, out: field):
        e, part = wp.tid()
        row = wp.where(together, 0, e)
        for n in range(part * share, part * share + share):
            u = load(r, 0, geo.nodes[e, n])
            v = load(r, geo.size, geo.nodes[e, n])
            put_fluxes(geo, u, v, row, e, n, f1, f2)
        if wp.static(together):
            for n in range(share):
                diverge(geo, f1, f2, row, e, n, out)

    @kernel
    def slope_fluxes(
        geo: geometry, east: field, east_flat: on_nodes, north: field, north_flat: on_nodes,
        f1: field, f2: field, out: field,
    ):  # fmt: skip
        e, part = wp.tid()
        row = wp.where(together, 0, e)
        for n in range(part * share, part * share + share):
            u = mul(geo.per_area[e, n], assembled(geo, east, east_flat, e, n))
            v = mul(geo.per_area[e, n], assembled(geo, north, north_flat, e, n))
            put_fluxes(geo, u, v, row, e, n, f1, f2)
        if wp.static(together):
            for n in range(share):
                diverge(geo, f1, f2, row, e, n, out)

    @kernel
    def eliminated(geo: geometry, local: field, flat: on_nodes, r: state, tau: real, b: field):
        e, part = wp.tid()
        for n in range(part * share, part * share + share):
            inflow = mul(geo.per_area[e, n], assembled(geo, local, flat, e, n))
            b[e, n, 0] = load(r, 2 * geo.size, geo.nodes[e, n]) - tau * inflow

    @kernel
    def chebyshev(
        geo: geometry, local: field, flat: on_nodes, sign: real, tau_tau_g: real, keep: real,
        take: real, beta: real, r: field, d: field, x: field,
    ):  # fmt: skip
        e, part = wp.tid()
        for n in range(part * share, part * share + share):
            second = mul(geo.per_area[e, n], assembled(geo, local, flat, e, n))
            residual = r[e, n, 0] + sign * (d[e, n, 0] - tau_tau_g * second)
            step = keep * d[e, n, 0] + take * mul(geo.per_diagonal[e, n], residual)
            r[e, n, 0] = residual
            d[e, n, 0] = step
            x[e, n, 0] = x[e, n, 0] + beta * step

    gather, places = gather_of(Register(real)), wp.array(dtype=Contributors)
    numbers, number = wp.array(dtype=wp.int32), entry_of(wp.int32)
    entry, given_entry, put = entry_of(real), entry_of(given), put_of(Register(given))

    @kernel
    def substituted(
        places_1: places, of_own: numbers, inverse_area: on_nodes, same: on_nodes, cross: on_nodes,
        size: int, east: on_nodes, north: on_nodes, h: on_nodes, r: state, tau_g: real, out: state,
    ):  # fmt: skip
        node = wp.tid()
        scale = tau_g * entry(inverse_area, node)
        u = real(given_entry(r, node)) - scale * gather(east, places_1, node, 0)
        v = real(given_entry(r, size + node)) - scale * gather(north, places_1, node, 0)
        s = entry(same, node)
        c = entry(cross, node)
        put(out, node, given(s * u + c * v))
        put(out, size + node, given(s * v - c * u))
        put(out, 2 * size + node, given(entry(h, number(of_own, node))))

    return EliminationKernels(
        gradient, divergence, wind_fluxes, slope_fluxes, eliminated, chebyshev, substituted,
        geometry, value, share, together,
    )  # fmt: skip


def _assembled(t: KernelTypes, geometry: Any) -> Any:
    """Return the function (geometry, local, flat, e, n): DSS at a node of an element."""
    np_, load = t.np, t.load

    @func
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


@functools.cache
def passage_kernels(np_: int, real: Any, given: Any, shape: str) -> tuple[wp.Kernel, wp.Kernel]:
    """Return the kernels between nodal vectors (N,) of `given` and fields of `real`.

    (nodes, x, out) spreads a vector to a field, and (of_own, flat, out) collects it.
    """
    t = KernelTypes(np_, real, shape, whole=False)
    load, share = load_of(t.register, given), np_ * np_ if shape == "element" else 1
    vector, field, nodes, places = (
        wp.array(dtype=given), t.local, wp.array2d(dtype=t.index), wp.array(dtype=wp.int32)
    )  # fmt: skip

    @kernel
    def spread(node: nodes, x: vector, out: field):
        e, part = wp.tid()
        for n in range(part * share, part * share + share):
            out[e, n, 0] = load(x, 0, node[e, n])

    @kernel
    def collect(of_own: places, flat: wp.array(dtype=real), out: vector):
        node = wp.tid()
        out[node] = given(flat[of_own[node]])

    return spread, collect
