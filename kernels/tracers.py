"""Blocks of tracer mass in state vectors: their DSS, and their algebra with the depth.

A tracer with mixing ratio q has the mass hq a unit area, which the wind carries exactly as it
carries the depth h, formulas and rounding included, so that q = 1 has the tendency of h.  State
vectors hold one block (N,) of hq a tracer, the first of them at the offset `first`; all tracers are
taken in one launch.
"""

import functools
from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from swe_sphere.kernels.access import gather_run, run_of
from swe_sphere.kernels.assembly import OPTIONS, Contributors
from swe_sphere.kernels.registers import product_of
from swe_sphere.kernels.stages import leave_of, node_types, stage_struct


@functools.cache
def blocks_kernel(real: type, adds: bool, lanes: int = 1) -> wp.Kernel:
    """DSS of `count` fields from local ones into, or `adds` onto, the blocks from `first` on.

    Kernel over nodes, or on a CPU over runs of `lanes` nodes, which fill a register: (places (N,),
    inverse_area (N,), stride, begin, N, count, first, local, stage, out), from the node `begin` on.
    """
    vector, stage = wp.array(dtype=real), stage_struct(real)
    value, _ = node_types(real, lanes)
    gather, load = gather_run(value, Contributors, real, lanes), run_of(value, real, lanes)
    leave = leave_of(value, real, lanes)
    mul: Any = product_of(value, real, lanes) if lanes > 1 else wp.mul

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def assemble(
        places: wp.array(dtype=Contributors),
        inverse_area: vector,
        stride: int,
        begin: int,
        size: int,
        count: int,
        first: int,
        local: vector,
        s: stage,
        out: vector,
    ):
        node = begin + lanes * wp.tid()
        scale = load(inverse_area, node)
        for k in range(count):
            at = first + k * size + node
            rate = mul(scale, gather(local, places, node, k * stride))
            if wp.static(adds):
                rate += load(out, at)
            leave(s, at, 0, rate, out)

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
        add=add,
    )
