"""One equation after the other: DSS, the step, and what is to be differentiated next, in one pass.

Continuity and momentum are each stepped by a kernel over the unique nodes that sums what the
elements left (`assembly.py`), moves its field on, and leaves combinations of the time levels for
the elements to differentiate next, so that no level is read for that alone.
"""

import functools
from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.access import entry_of, put_of
from swe_sphere.kernels.assembly import OPTIONS, Contributors, gather_sum
from swe_sphere.kernels.pointwise import Pointwise, pointwise_rates


@functools.cache
def level_kernels(
    unknowns: int, real: type, point: Pointwise, damped: bool, tracers: bool
) -> SimpleNamespace:
    """Kernels over N threads that step `depth` and `wind`, with the `structure` of the terms.

    depth: (places, inverse_area, stride, N, count, local, c, tau, now, past, loss, base, flows,
    mixes, out, carried, pushed): out = now + tau (rate + loss) in the `count` blocks of depth and
    tracers, with the rates of `point` at the masses `carried` and the wind of `pushed`.  Then
    `carried` becomes the sum of (out, now, past) with the weights `flows`, and the depth of
    `pushed` that with the weights `mixes`.
    wind: (places, inverse_area, stride, N, local, c, tau, now, past, loss, base, turns, out,
    carried, pushed): the same for both winds with the rates at `pushed`, whose winds get the
    weights `turns`.
    `loss` is only read where `damped`; `out` may be any of the levels.  Where `point` is a tangent
    all combinations are less `base`, and `carried` has those of the winds as well.
    """
    first, vector, gather = (unknowns - 1), wp.array(dtype=real), gather_sum(real)
    triple, place = wp.types.vector(3, real), entry_of(Contributors)
    entry, put = entry_of(real), put_of(real)
    rates, moves, shifted = pointwise_rates(unknowns, real, point), unknowns == 3, point.tangent
    structure, of_wind, of_depth = rates.structure, rates.wind, rates.depth

    @no_type_check
    @wp.func
    def total(w: triple, new: real, now: real, past: real, base: vector, k: int):
        r = w[0] * new + w[1] * now + w[2] * past
        if wp.static(shifted):
            r -= entry(base, k)
        return r

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
        loss: vector,
        base: vector,
        flows: triple,
        mixes: triple,
        out: vector,
        carried: vector,
        pushed: vector,
    ):
        i = wp.tid()
        at = place(places, i)
        scale = entry(inverse_area, i)
        k = first * size + i
        rate = scale * gather(local, at, 0) + of_depth(c, i, size + i, k, pushed, carried)
        if wp.static(damped):
            rate += entry(loss, k)
        h = entry(now, k)
        h1 = entry(past, k)
        new = h + tau * rate
        put(carried, k, total(flows, new, h, h1, base, k))
        if wp.static(moves):
            put(pushed, k, total(mixes, new, h, h1, base, k))
        put(out, k, new)
        if wp.static(tracers):
            for block in range(1, count):
                k += size
                rate = scale * gather(local, at, block * stride)
                if wp.static(damped):
                    rate += entry(loss, k)
                h = entry(now, k)
                new = h + tau * rate
                put(carried, k, total(flows, new, h, entry(past, k), base, k))
                put(out, k, new)

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
        turns: triple,
        out: vector,
        carried: vector,
        pushed: vector,
    ):
        i = wp.tid()
        j = size + i
        at = place(places, i)
        scale = entry(inverse_area, i)
        wind = of_wind(c, i, j, size + j, pushed)
        rate_u = scale * gather(local, at, 0) + wind[0]
        rate_v = scale * gather(local, at, stride) + wind[1]
        if wp.static(damped):
            rate_u += entry(loss, i)
            rate_v += entry(loss, j)
        u = entry(now, i)
        v = entry(now, j)
        new_u = u + tau * rate_u
        new_v = v + tau * rate_v
        mixed_u = total(turns, new_u, u, entry(past, i), base, i)
        mixed_v = total(turns, new_v, v, entry(past, j), base, j)
        put(pushed, i, mixed_u)
        put(pushed, j, mixed_v)
        if wp.static(shifted):
            put(carried, i, mixed_u)
            put(carried, j, mixed_v)
        put(out, i, new_u)
        put(out, j, new_v)

    return SimpleNamespace(depth=step_depth, wind=step_wind, structure=structure)


@functools.cache
def combine_levels_kernel(real: type, shifted: bool) -> wp.Kernel:
    """Kernel (first, now, past, older, weights, base, out): their sum, from the offset on.

    Less `base`, where it is `shifted`; as the kernels above leave it when they have stepped.
    """
    vector, triple = wp.array(dtype=real), wp.types.vector(3, real)
    entry, put = entry_of(real), put_of(real)

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
        value = (
            weights[0] * entry(now, k) + weights[1] * entry(past, k) + weights[2] * entry(older, k)
        )
        if wp.static(shifted):
            value -= entry(base, k)
        put(out, k, value)

    return combine_levels
