"""Blocks of tracer mass in state vectors: their DSS, and their algebra with the depth.

A tracer with mixing ratio q has the mass hq a unit area, which the wind carries exactly as it
carries the depth h, formulas and rounding included, so that q = 1 has the tendency of h.  State
vectors hold one block (N,) of hq a tracer, the first of them at the offset `first`; all tracers are
taken in one launch.
"""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from swe_sphere.kernels.define import kernel
from swe_sphere.kernels.simd.arithmetic import product_of
from swe_sphere.kernels.simd.memory import Contributors, gather_of, run_of
from swe_sphere.kernels.simd.register import Register
from swe_sphere.kernels.simd.stages import leave_of, stage_struct


@functools.cache
def blocks_kernel(real: Any, adds: bool, lanes: int = 1) -> wp.Kernel:
    """Return the kernel that assembles `count` local fields into the blocks from `first` on.

    If it `adds`, the result is added to the blocks.  It runs over nodes, or on a CPU over runs of
    `lanes` nodes, which fill a register: (begin, places (N,), inverse_area (N,), stride, N, count,
    first, local, stage, out), from the node `begin` on.
    """
    register, vector, stage = Register(real, lanes), wp.array(dtype=real), stage_struct(real)
    gather, load, mul = gather_of(register), run_of(register), product_of(register)
    rows, leave = register.rows(1), leave_of(register, 1)

    @kernel
    def assemble(
        begin: int, places: wp.array(dtype=Contributors), inverse_area: vector, stride: int,
        size: int, count: int, first: int, local: vector, s: stage, out: vector,
    ):  # fmt: skip
        node = begin + lanes * wp.tid()
        scale = load(inverse_area, node)
        for k in range(count):
            at = first + k * size + node
            rate = rows()
            rate[0] = mul(scale, gather(local, places, node, k * stride))
            if wp.static(adds):
                rate[0] = rate[0] + load(out, at)
            leave(s, at, 0, rate, out)

    return assemble


@dataclass(frozen=True)
class TracerKernels:
    """Algebra between tracers and depth, node by node; over (tracers, N) threads.

    `depth` and `first` are the offsets of the depth and of the first tracer in a state vector x.
    """

    mixing_ratio: wp.Kernel
    """(x, depth, first, N, q (tracers*N,)): q = hq / h."""
    follow: wp.Kernel
    """(r, x, q, depth, first, N): x_hq = r_hq + q (x_h - r_h)."""
    correct: wp.Kernel
    """(q, flux, air, factor, depth, first, N, r, x): x_hq = r_hq + q (x_h - r_h) + factor (flux -
    q air), air (N,) being the flux where q = 1."""
    raised: wp.Kernel
    """(x, bottom, depth, first, N, out): out = hq (1 + b/h)."""
    raised_tangent: wp.Kernel
    """(base, bottom, depth, first, N, x, out): derivative of `raised` at `base` along x."""


@functools.cache
def pointwise_kernels(real: Any) -> TracerKernels:
    """Return the kernels."""
    vector = wp.array(dtype=real)

    @kernel
    def mixing_ratio(x: vector, depth: int, first: int, size: int, q: vector):
        k, node = wp.tid()
        at = k * size + node
        q[at] = x[first + at] / x[depth + node]

    @kernel
    def follow(r: vector, x: vector, q: vector, depth: int, first: int, size: int):
        k, node = wp.tid()
        at = k * size + node
        x[first + at] = r[first + at] + q[at] * (x[depth + node] - r[depth + node])

    @kernel
    def correct(
        q: vector, flux: vector, air: vector, factor: real, depth: int, first: int, size: int,
        r: vector, x: vector,
    ):  # fmt: skip
        k, node = wp.tid()
        at = k * size + node
        change = q[at] * (x[depth + node] - r[depth + node])
        x[first + at] = r[first + at] + change + factor * (flux[at] - q[at] * air[node])

    @kernel
    def raised(x: vector, bottom: vector, depth: int, first: int, size: int, out: vector):
        k, node = wp.tid()
        at = k * size + node
        out[at] = x[first + at] * (real(1.0) + bottom[node] / x[depth + node])

    @kernel
    def raised_tangent(
        base: vector, bottom: vector, depth: int, first: int, size: int, x: vector, out: vector
    ):
        k, node = wp.tid()
        at = k * size + node
        h = base[depth + node]
        slope = bottom[node] / h
        lost = base[first + at] * slope / h * x[depth + node]
        out[at] = x[first + at] * (real(1.0) + slope) - lost

    return TracerKernels(mixing_ratio, follow, correct, raised, raised_tangent)


@functools.cache
def flux_kernel(real: Any) -> wp.Kernel:
    """Return the kernel (wind, x, depth, N, out) over N: out (2N,) = h (u, v), h in x[depth:]."""
    vector = wp.array(dtype=real)

    @kernel
    def flux(wind: vector, x: vector, depth: int, size: int, out: vector):
        node = wp.tid()
        h = x[depth + node]
        out[node] = h * wind[node]
        out[size + node] = h * wind[size + node]

    return flux
