"""Stages of long tracer steps, whose mass flux F is that of many dynamics steps, fixed in time.

The masses m = hq of tracers follow dm/dt = -div(q F), q = m / h, while the depth goes evenly from
its value before the step to that after it, h(t) = air + t rate with rate = -div(F): q = 1 stays 1.

Masses and ratios are kept in blocks of up to `LANES` tracers that stand side by side on a CPU: a
node is a cache line, and a product one instruction for all tracers of a block.
"""

import functools
from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.assembly import OPTIONS, Contributors
from swe_sphere.kernels.element import line_sums
from swe_sphere.kernels.stages import leave_of, stage_struct
from swe_sphere.kernels.terms import kernel_types

LANES = (4, 8)
"""Tracers side by side, few or many."""


@functools.cache
def crossing_kernels(np_: int, real: type) -> SimpleNamespace:
    """Kernels over E elements, with the structure `geometry` that they read; flux (2N, ...).

    contravariant: (geometry, flux, out (E, np*np, 2)): the flux across lines of each reference
    coordinate, times the area element J.
    crossings: (geometry, flux, air (N,), out (E,)): the largest sum of the two contravariant speeds
    |d xi / dt| [s-1] of flux / air, in an element whose sides have length 2 in xi.
    """
    t = kernel_types(np_, real, "node")
    geometry, vector, wedge = t.geometry, t.vector, t.ops.wedge

    @no_type_check
    @wp.func
    def across(geo: geometry, flux: vector, e: int, n: int):
        node = geo.nodes[e, n]
        u = flux[node]
        v = flux[geo.size + node]
        one = wedge(u, v, geo.basis[e, n, 2], geo.basis[e, n, 3])
        return one, wedge(geo.basis[e, n, 0], geo.basis[e, n, 1], u, v)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def contravariant(geo: geometry, flux: vector, out: wp.array3d(dtype=real)):
        e = wp.tid()
        for n in range(np_ * np_):
            one, two = across(geo, flux, e, n)
            out[e, n, 0] = one
            out[e, n, 1] = two

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def crossings(geo: geometry, flux: vector, air: vector, out: vector):
        e = wp.tid()
        most = real(0.0)
        for n in range(np_ * np_):
            one, two = across(geo, flux, e, n)
            area = wedge(
                geo.basis[e, n, 0], geo.basis[e, n, 1], geo.basis[e, n, 2], geo.basis[e, n, 3]
            )
            most = wp.max(most, (wp.abs(one) + wp.abs(two)) / (area * air[geo.nodes[e, n]]))
        out[e] = most

    return SimpleNamespace(contravariant=contravariant, crossings=crossings, geometry=t.geometry)


@functools.cache
def divergence_kernel(np_: int, real: type, lanes: int) -> wp.Kernel:
    """Kernel over (E, blocks): (nodes (E, np*np), derivative, weight, across, N, q, out).

    out (blocks, E*np*np) = the mass-weighted -div(q F), before DSS, of q (blocks*N,) and `across`,
    what `contravariant` makes of F.
    """
    value, matrix = wp.types.vector(lanes, real), wp.array2d(dtype=real)
    d1, d2, _, _ = line_sums(SimpleNamespace(np=np_, real=real, lanes=lanes), value)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def divergence(
        nodes: wp.array2d(dtype=wp.int32),
        derivative: matrix,
        weight: matrix,
        across: wp.array3d(dtype=real),
        size: int,
        q: wp.array(dtype=value),
        out: wp.array2d(dtype=value),
    ):
        e, b = wp.tid()
        f1 = wp.zeros(shape=(np_, np_), dtype=value)
        f2 = wp.zeros(shape=(np_, np_), dtype=value)
        for i in range(np_):
            for j in range(np_):
                n = i * np_ + j
                ratio = q[b * size + nodes[e, n]]
                f1[i, j] = across[e, n, 0] * ratio
                f2[i, j] = across[e, n, 1] * ratio
        for i in range(np_):
            for j in range(np_):
                div = d1(derivative, f1, i, j) + d2(derivative, f2, i, j)
                out[b, (e * np_ + i) * np_ + j] = -weight[i, j] * div

    return divergence


@functools.cache
def stage_kernels(real: type, lanes: int) -> SimpleNamespace:
    """Kernels over (N, blocks), with the type `value` of a block's tracers on a node.

    `state` holds `count` masses from the offset `first` on, N of each; mass and q (blocks*N,).
    begin: (state, first, count, N, air (N,), rate (N,), t, mass, q): into blocks, q at the time t.
    stage: (places (N,), inverse_area (N,), N, local, tau, air, rate, t, keep, mass, q): DSS, and
    q = (mass + tau tendency) / h(t); if `keep` is 1 that is the new mass too.
    finish: (mass, first, count, N, state): out of blocks.
    """
    value, vector = wp.types.vector(lanes, real), wp.array(dtype=real)
    values, fields = wp.array(dtype=value), wp.array2d(dtype=value)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def begin(
        state: vector,
        first: int,
        count: int,
        size: int,
        air: vector,
        rate: vector,
        t: real,
        mass: values,
        q: values,
    ):
        node, b = wp.tid()
        m = value(real(0.0))
        for lane in range(lanes):
            k = b * lanes + lane
            if k < count:
                m[lane] = state[first + k * size + node]
        mass[b * size + node] = m
        q[b * size + node] = m / (air[node] + t * rate[node])

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def stage(
        places: wp.array(dtype=Contributors),
        inverse_area: vector,
        size: int,
        local: fields,
        tau: real,
        air: vector,
        rate: vector,
        t: real,
        keep: int,
        mass: values,
        q: values,
    ):
        node, b = wp.tid()
        at = places[node]
        total = local[b, at[0]]
        if at[1] >= 0:
            total += local[b, at[1]]
            if at[2] >= 0:
                total += local[b, at[2]] + local[b, at[3]]
        m = mass[b * size + node] + (tau * inverse_area[node]) * total
        if keep == 1:
            mass[b * size + node] = m
        q[b * size + node] = m / (air[node] + t * rate[node])

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def finish(mass: values, first: int, count: int, size: int, state: vector):
        node, b = wp.tid()
        m = mass[b * size + node]
        for lane in range(lanes):
            k = b * lanes + lane
            if k < count:
                state[first + k * size + node] = m[lane]

    return SimpleNamespace(begin=begin, stage=stage, finish=finish, value=value)


@functools.cache
def flux_kernel(real: type) -> wp.Kernel:
    """Kernel over N: (wind, x, depth, N, first, stage, out): out[first:] = h (u, v).

    The winds stand in front of `wind`, h in x[depth:].
    """
    vector, leave, stage = wp.array(dtype=real), leave_of(real, real), stage_struct(real)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False)
    def flux(wind: vector, x: vector, depth: int, size: int, first: int, s: stage, out: vector):
        node = wp.tid()
        h = x[depth + node]
        leave(s, first + node, 0, h * wind[node], out)
        leave(s, first + size + node, 0, h * wind[size + node], out)

    return flux
