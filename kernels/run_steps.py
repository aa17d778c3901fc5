"""Continuity and momentum stepped in registers: the launch shape for CPUs.

Nodes inside elements need no DSS: the kernels over elements step them themselves.  Of the others,
as many are summed as a register holds.  What is left over goes to `forward_backward.py`.
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
from swe_sphere.kernels.pointwise import Pointwise, in_registers
from swe_sphere.kernels.terms import kernel_types


@functools.cache
def carrying_kernel(
    np_: int, unknowns: int, real: type, point: Pointwise, damped: bool
) -> SimpleNamespace:
    """Kernel (geometry, a, x, first, count, out, levels): `transport` of the field kernels.

    Nodes inside the elements of the first `whole` groups are stepped.
    """
    t, moves = _stepping_types(np_, unknowns, real, point, damped), unknowns == 3
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
                        finish(geo, s, k, at, geo.nodes[e, n], r)
                    else:
                        out[e, n, k] = r

    return SimpleNamespace(kernel=carry, geometry=geometry)


@functools.cache
def run_kernels(unknowns: int, real: type, point: Pointwise, damped: bool) -> SimpleNamespace:
    """Kernels over runs of nodes that step `depth` and `wind`, as `level_kernels` do.

    Arguments: the `geometry`, places, stride, begin, for the depth the count of masses, the local
    tendencies and the levels.
    """
    t = _stepping_types(2, unknowns, real, point, damped)
    lanes, numbers, winds, pair = t.lanes, t.index, t.struct("Winds", ["u", "v"]), t.rows(2)
    gather = gather_run(t.value, Contributors, real, lanes)
    load, first = t.ops.load_run, unknowns - 1
    mass, wind = finish_mass(t, unknowns == 3), finish_wind(t, winds)
    place, local, levels = wp.array(dtype=Contributors), t.vector, t.done

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def run_depth(
        geo: t.geometry, places: place, stride: int, begin: int, count: int, local: local, s: levels
    ):
        at = begin + lanes * wp.tid()
        node = numbers()
        node[0] = ~at
        for k in range(count):
            mass(geo, s, k, (first + k) * geo.size, node, gather(local, places, at, k * stride))

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def run_wind(geo: t.geometry, places: place, stride: int, begin: int, local: local, s: levels):
        at = begin + lanes * wp.tid()
        node = numbers()
        node[0] = ~at
        x = winds()
        x.u = load(s.pushed, 0, node)
        x.v = load(s.pushed, geo.size, node)
        r = pair()
        r[0] = gather(local, places, at, 0)
        r[1] = gather(local, places, at, stride)
        wind(geo, x, r, node, s)

    return SimpleNamespace(depth=run_depth, wind=run_wind, geometry=t.geometry)


def _stepping_types(
    np_: int, unknowns: int, real: type, point: Pointwise, damped: bool
) -> SimpleNamespace:
    rates = in_registers(unknowns, real, point)
    return kernel_types(
        np_, real, "element", direct=True, done=levels_struct(real), damped=damped, **rates
    )
