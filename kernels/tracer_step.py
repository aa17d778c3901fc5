"""Stages of long tracer steps, whose mass flux F is that of many dynamics steps, fixed in time.

The masses m = hq of tracers follow dm/dt = -div(q F), q = m / h, while the depth goes evenly from
its value before the step to that after it, h(t) = air + t rate with rate = -div(F): q = 1 stays 1.

Masses and ratios are kept in blocks of up to `LANES` tracers that stand side by side on a CPU: a
node is a cache line, and a product one instruction for all tracers of a block.
"""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from swe_sphere.kernels.define import func, kernel
from swe_sphere.kernels.element import line_sums
from swe_sphere.kernels.simd.memory import Contributors
from swe_sphere.kernels.simd.register import Register
from swe_sphere.kernels.simd.stages import leave_of, stage_struct
from swe_sphere.kernels.terms import KernelTypes

LANES = (4, 8)
"""Tracers side by side, few or many."""


@functools.cache
def crossing_kernels(np_: int, real: Any) -> tuple[wp.Kernel, wp.Kernel, Any]:
    """Return the kernels `contravariant` and `crossings` over E elements, and their geometry.

    `contravariant` (geometry, flux (2N, ...), out (E, np*np, 2)): the flux across lines of each
    reference coordinate, times the area element J.  `crossings` (geometry, flux, air (N,), out
    (E,)): the largest sum of the two contravariant speeds |d xi / dt| [s-1] of flux / air, in an
    element whose sides have length 2 in xi.
    """
    t = KernelTypes(np_, real, "node")
    geometry, vector, area = t.geometry, t.vector, t.metric.area
    contravariant_flux = t.metric.contravariant_flux

    @func
    def across(geo: geometry, flux: vector, e: int, n: int):
        node = geo.nodes[e, n]
        return contravariant_flux(geo.basis, e, n, flux[node], flux[geo.size + node])

    @kernel
    def contravariant(geo: geometry, flux: vector, out: wp.array3d(dtype=real)):
        e = wp.tid()
        for n in range(np_ * np_):
            one, two = across(geo, flux, e, n)
            out[e, n, 0] = one
            out[e, n, 1] = two

    @kernel
    def crossings(geo: geometry, flux: vector, air: vector, out: vector):
        e = wp.tid()
        most = real(0.0)
        for n in range(np_ * np_):
            one, two = across(geo, flux, e, n)
            room = area(geo.basis, e, n) * air[geo.nodes[e, n]]
            most = wp.max(most, (wp.abs(one) + wp.abs(two)) / room)
        out[e] = most

    return contravariant, crossings, geometry


@functools.cache
def divergence_kernel(np_: int, real: Any, lanes: int) -> wp.Kernel:
    """Return the kernel (nodes (E, np*np), derivative, weight, across, N, q, out).

    It runs over (E, blocks).  out (blocks, E*np*np) = the mass-weighted -div(q F), before DSS, of q
    (blocks*N,) and `across`, the contravariant flux of F.
    """
    value, matrix = wp.types.vector(lanes, real), wp.array2d(dtype=real)
    d1, d2, _, _ = line_sums(Register(real, lanes), np_, value)

    @kernel
    def divergence(
        nodes: wp.array2d(dtype=wp.int32), derivative: matrix, weight: matrix,
        across: wp.array3d(dtype=real), size: int, q: wp.array(dtype=value),
        out: wp.array2d(dtype=value),
    ):  # fmt: skip
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


@dataclass(frozen=True)
class StageKernels:
    """Kernels over (N, blocks); mass and q (blocks*N,) hold the tracers of a block side by side.

    `state` holds `count` masses from the offset `first` on, N of each.
    """

    begin: wp.Kernel
    """(state, first, count, N, air (N,), rate (N,), t, mass, q): into blocks, q at the time t."""
    stage: wp.Kernel
    """(places (N,), inverse_area (N,), N, local, tau, air, rate, t, keep, mass, q): DSS, and
    q = (mass + tau tendency) / h(t); if `keep` is 1, this is the new mass too."""
    finish: wp.Kernel
    """(mass, first, count, N, state): out of blocks."""
    value: Any
    """Type of a block's tracers on a node."""


@functools.cache
def stage_kernels(real: Any, lanes: int) -> StageKernels:
    """Return the kernels for blocks of `lanes` tracers."""
    value, vector = wp.types.vector(lanes, real), wp.array(dtype=real)
    values, fields = wp.array(dtype=value), wp.array2d(dtype=value)

    @kernel
    def begin(
        state: vector, first: int, count: int, size: int, air: vector, rate: vector, t: real,
        mass: values, q: values,
    ):  # fmt: skip
        node, b = wp.tid()
        m = value(real(0.0))
        for lane in range(lanes):
            k = b * lanes + lane
            if k < count:
                m[lane] = state[first + k * size + node]
        mass[b * size + node] = m
        q[b * size + node] = m / (air[node] + t * rate[node])

    @kernel
    def stage(
        places: wp.array(dtype=Contributors), inverse_area: vector, size: int, local: fields,
        tau: real, air: vector, rate: vector, t: real, keep: int, mass: values, q: values,
    ):  # fmt: skip
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

    @kernel
    def finish(mass: values, first: int, count: int, size: int, state: vector):
        node, b = wp.tid()
        m = mass[b * size + node]
        for lane in range(lanes):
            k = b * lanes + lane
            if k < count:
                state[first + k * size + node] = m[lane]

    return StageKernels(begin, stage, finish, value)


@functools.cache
def flux_kernel(real: Any) -> wp.Kernel:
    """Return the kernel (wind, x, depth, N, first, stage, out) over N: out[first:] = h (u, v).

    The winds stand in front of `wind`, h in x[depth:].
    """
    vector, stage, leave = wp.array(dtype=real), stage_struct(real), leave_of(Register(real), 1)
    row = wp.types.vector(1, real)

    @kernel
    def flux(wind: vector, x: vector, depth: int, size: int, first: int, s: stage, out: vector):
        node = wp.tid()
        h = x[depth + node]
        leave(s, first + node, 0, row(h * wind[node]), out)
        leave(s, first + size + node, 0, row(h * wind[size + node]), out)

    return flux
