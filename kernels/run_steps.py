"""Continuity and momentum stepped by kernels: at nodes, or on a CPU in runs that fill a register.

Nodes inside elements need no DSS: on a CPU the kernels over elements step them themselves.
"""

import functools
from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.access import gather_run, scratch
from swe_sphere.kernels.assembly import OPTIONS, Contributors
from swe_sphere.kernels.dynamics import mass_flux
from swe_sphere.kernels.element import line_sums
from swe_sphere.kernels.forward_backward import finish_mass, finish_wind, levels_struct
from swe_sphere.kernels.pointwise import Pointwise, pointwise_sum
from swe_sphere.kernels.terms import kernel_types, lanes_of


@functools.cache
def carrying_kernel(
    np_: int, unknowns: int, real: type, point: Pointwise, damped: bool
) -> SimpleNamespace:
    """Kernel (geometry, a, x, first, count, out, levels): `transport` of the field kernels.

    Nodes inside the elements of the first `whole` groups are stepped.
    """
    lanes, moves = lanes_of(real), unknowns == 3
    t = _stepping_types(np_, unknowns, real, point, damped, lanes)
    value, last, (d1, d2, _, _) = t.value, np_ - 1, line_sums(t, t.value)
    geometry, vector, local = t.geometry, t.vector, t.local
    load, wedge, flux, finish = t.ops.load, t.ops.wedge, mass_flux(t, False), finish_mass(t, moves)
    _, at_2, _ = scratch(np_, value, value)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def carry(geo: geometry, a: vector, x: vector, first: int, count: int, out: local, s: t.done):
        e = wp.tid()
        f1 = wp.array(ptr=geo.work, shape=(np_, np_), dtype=value)
        f2 = wp.array(ptr=geo.work + at_2, shape=(np_, np_), dtype=value)
        for k in range(count):
            at = first + k * geo.size
            for i in range(np_):
                for j in range(np_):
                    n = i * np_ + j
                    node = geo.nodes[e, n]
                    m = load(x, at, node)
                    u = load(a, 0, node)
                    v = load(a, geo.size, node)
                    fu, fv = flux(u, v, m, u, v, m)
                    f1[i, j] = wedge(fu, fv, geo.basis[e, n, 2], geo.basis[e, n, 3])
                    f2[i, j] = wedge(geo.basis[e, n, 0], geo.basis[e, n, 1], fu, fv)
            for i in range(np_):
                for j in range(np_):
                    n = i * np_ + j
                    div = d1(geo.derivative, f1, i, j) + d2(geo.derivative, f2, i, j)
                    r = -geo.weight[i, j] * div
                    if e < geo.whole and i > 0 and i < last and j > 0 and j < last:
                        finish(geo, s, k, at, ~geo.nodes[e, n][0], r)
                    else:
                        out[e, n, k] = r

    return SimpleNamespace(kernel=carry, geometry=geometry)


@functools.cache
def run_kernels(
    unknowns: int, real: type, point: Pointwise, damped: bool, lanes: int
) -> SimpleNamespace:
    """Kernels over runs of `lanes` nodes that sum up what elements left, and step it.

    depth: (geometry, places, stride, begin, count, local, levels): from the node `begin` on, out =
    now + tau (rate + loss) in the `count` blocks of depth and tracers, with the rates of `point` at
    the masses `carried` and the wind of `pushed`; then the combinations of `levels_struct`.
    wind: (geometry, places, stride, begin, local, levels): the same for both winds with the rates
    at `pushed`.  `loss` is only read where `damped`.  Where `point` is a tangent all combinations
    are less `base`, and `carried` has those of the winds as well.
    """
    t = _stepping_types(2, unknowns, real, point, damped, lanes)
    members = {"size": wp.int32, "inverse_area": t.vector, "point": t.point.structure}
    t.geometry = wp.struct(type("Geometry", (), {"__annotations__": members}))
    gather = gather_run(t.value, Contributors, real, lanes)
    first, pair = unknowns - 1, t.rows(2)
    mass, finish = finish_mass(t, unknowns == 3, point.tangent), finish_wind(t, point.tangent)
    place, local, levels = wp.array(dtype=Contributors), t.vector, t.done

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def depth(
        geo: t.geometry, places: place, stride: int, begin: int, count: int, local: local, s: levels
    ):
        node = begin + lanes * wp.tid()
        for k in range(count):
            mass(geo, s, k, (first + k) * geo.size, node, gather(local, places, node, k * stride))

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def wind(geo: t.geometry, places: place, stride: int, begin: int, local: local, s: levels):
        node = begin + lanes * wp.tid()
        r = pair()
        r[0] = gather(local, places, node, 0)
        r[1] = gather(local, places, node, stride)
        finish(geo, r, node, s)

    moves = wind if unknowns == 3 else None
    return SimpleNamespace(depth=depth, wind=moves, geometry=t.geometry)


def _stepping_types(
    np_: int, unknowns: int, real: type, point: Pointwise, damped: bool, lanes: int
) -> SimpleNamespace:
    return kernel_types(
        np_, real, "element" if lanes > 1 else "node", direct=True, done=levels_struct(real),
        damped=damped, point=pointwise_sum(unknowns, real, point, lanes),
    )  # fmt: skip
