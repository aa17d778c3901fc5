"""One equation after the other: DSS, the step, and what is to be differentiated next, in one pass.

Continuity and momentum are each stepped by a kernel over the unique nodes that sums what the
elements left (`assembly.py`), moves its field on, and leaves combinations of the time levels for
the elements to differentiate next, so that no level is read for that alone.
"""

import functools
from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.assembly import OPTIONS, Contributors, gather_sum
from swe_sphere.kernels.pointwise import Pointwise, pointwise_rates


@functools.cache
def level_kernels(unknowns: int, real: type, point: Pointwise, damped: bool) -> SimpleNamespace:
    """Kernels over N threads that step `depth` and `wind`, with the `structure` of the terms.

    depth: (places, inverse_area, stride, N, count, local, c, tau, now, past, older, loss, base,
    flows, mixes, out, carried, pushed): out = now + tau (rate + loss) in the `count` blocks of
    depth and tracers, with the rates of `point` at the vector `carried`.  That becomes the sum of
    (out, now, past) with the weights `flows`, and the depth of `pushed` that of (out, now, past,
    older) with the weights `mixes`, both less `base` where `point` is a tangent.
    wind: (places, inverse_area, stride, N, local, c, tau, now, past, loss, base, flows, turns, out,
    carried, pushed): the same for both winds with the rates at `pushed`; `carried` gets the weights
    `flows`, `pushed` the weights `turns`.  `loss` is only read where `damped`; `out` may be any
    of the levels.
    """
    first, vector, gather = (unknowns - 1), wp.array(dtype=real), gather_sum(real)
    triple, four = wp.types.vector(3, real), wp.types.vector(4, real)
    rates, moves, shifted = pointwise_rates(unknowns, real, point), unknowns == 3, point.tangent
    structure, of_wind, of_depth = rates.structure, rates.wind, rates.depth

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def step_depth(
        places: wp.array(dtype=Contributors),
        inverse_area: vector,
        stride: int,
        size: int,
        count: int,
        local: vector,
        c: structure,
        tau: real,
        now: vector,
        past: vector,
        older: vector,
        loss: vector,
        base: vector,
        flows: triple,
        mixes: four,
        out: vector,
        carried: vector,
        pushed: vector,
    ):
        i = wp.tid()
        at = places[i]
        scale = inverse_area[i]
        for block in range(count):
            k = (first + block) * size + i
            rate = scale * gather(local, at, block * stride)
            if block == 0:
                rate += of_depth(c, i, size + i, k, carried)
            if wp.static(damped):
                rate += loss[k]
            h = now[k]
            h1 = past[k]
            moved = h + tau * rate
            flow = flows[0] * moved + flows[1] * h + flows[2] * h1
            if wp.static(moves):
                if block == 0:
                    mixed = mixes[0] * moved + mixes[1] * h + mixes[2] * h1 + mixes[3] * older[k]
                    if wp.static(shifted):
                        mixed -= base[k]
                    pushed[k] = mixed
            if wp.static(shifted):
                flow -= base[k]
            carried[k] = flow
            out[k] = moved

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def step_wind(
        places: wp.array(dtype=Contributors),
        inverse_area: vector,
        stride: int,
        size: int,
        local: vector,
        c: structure,
        tau: real,
        now: vector,
        past: vector,
        loss: vector,
        base: vector,
        flows: triple,
        turns: triple,
        out: vector,
        carried: vector,
        pushed: vector,
    ):
        i = wp.tid()
        j = size + i
        at = places[i]
        scale = inverse_area[i]
        wind = of_wind(c, i, j, size + j, pushed)
        rate_u = scale * gather(local, at, 0) + wind[0]
        rate_v = scale * gather(local, at, stride) + wind[1]
        if wp.static(damped):
            rate_u += loss[i]
            rate_v += loss[j]
        u = now[i]
        v = now[j]
        u1 = past[i]
        v1 = past[j]
        moved_u = u + tau * rate_u
        moved_v = v + tau * rate_v
        flow_u = flows[0] * moved_u + flows[1] * u + flows[2] * u1
        flow_v = flows[0] * moved_v + flows[1] * v + flows[2] * v1
        turn_u = turns[0] * moved_u + turns[1] * u + turns[2] * u1
        turn_v = turns[0] * moved_v + turns[1] * v + turns[2] * v1
        if wp.static(shifted):
            flow_u -= base[i]
            flow_v -= base[j]
            turn_u -= base[i]
            turn_v -= base[j]
        carried[i] = flow_u
        carried[j] = flow_v
        pushed[i] = turn_u
        pushed[j] = turn_v
        out[i] = moved_u
        out[j] = moved_v

    return SimpleNamespace(depth=step_depth, wind=step_wind, structure=structure)


@functools.cache
def combine_levels_kernel(real: type, shifted: bool) -> wp.Kernel:
    """Kernel (first, now, past, older, weights, base, out): their sum, from the offset on.

    Less `base`, where it is `shifted`; as the kernels above leave it when they have stepped.
    """
    vector, triple = wp.array(dtype=real), wp.types.vector(3, real)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False)
    def combine_levels(
        first: int,
        now: vector,
        past: vector,
        older: vector,
        weights: triple,
        base: vector,
        out: vector,
    ):
        k = first + wp.tid()
        value = weights[0] * now[k] + weights[1] * past[k] + weights[2] * older[k]
        if wp.static(shifted):
            value -= base[k]
        out[k] = value

    return combine_levels
