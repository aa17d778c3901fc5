"""One equation after the other: time levels, DSS, the step, and what is differentiated next.

Continuity and momentum are each stepped by a kernel over the unique nodes that sums what the
elements left (`assembly.py`), moves its field on, and leaves combinations of the time levels for
the elements to differentiate next, so that no level is read for that alone.
"""

import functools
from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.access import entry_of, put_of, step_run
from swe_sphere.kernels.assembly import OPTIONS, Contributors, gather_sum
from swe_sphere.kernels.pointwise import Pointwise, pointwise_sum


@functools.cache
def levels_struct(real: type) -> type:
    """Warp structure of what a pass reads and writes beside the rates.

    Vectors of all unknowns: the levels `now` and `past`, the `loss` and the `base`, the result
    `out`, which may be any of the levels, and the combinations `carried` and `pushed` that the
    elements differentiate next.  `tau` [s]; the weights of (out, now, past) in the masses of
    `carried` or the winds of `pushed`, and as `mixes` those in the depth of `pushed`.
    """
    names = "now", "past", "loss", "base", "out", "carried", "pushed"
    members: dict[str, object] = dict.fromkeys(names, wp.array(dtype=real))
    triple = wp.types.vector(3, real)
    members |= {"tau": real, "weights": triple, "mixes": triple}
    structure: type = wp.struct(type("Levels", (), {"__annotations__": members}))
    return structure


def finish_mass(t: SimpleNamespace, moves: bool) -> wp.Function:
    """Function (geometry, levels, k, offset, node, result): of the k-th mass; the depth first.

    moves: whether the depth pushes the wind.
    """
    load, mul, of_depth = t.ops.load_run, t.ops.mul, t.point and t.point.depth
    step = step_run(t.value, t.index, t.real, t.lanes)

    @no_type_check
    @wp.func
    def finish(geo: t.geometry, s: t.done, k: int, at: int, node: t.index, result: t.value):
        rate = mul(load(geo.inverse_area, 0, node), result)
        if wp.static(of_depth is not None):  # noqa: SIM102 - a static choice is an if of its own
            if k == 0:
                rate += of_depth(geo.point, ~node[0], geo.size, s.pushed, s.carried)
        if wp.static(t.damped):
            rate += load(s.loss, at, node)
        if wp.static(moves) and k == 0:  # first, as `out` may be a level, which is gone then
            step(s.now, s.past, at, node, rate, s.tau, s.mixes, s.pushed, s.pushed)
        step(s.now, s.past, at, node, rate, s.tau, s.weights, s.out, s.carried)

    return finish


def finish_wind(t: SimpleNamespace, winds: type) -> wp.Function:
    """Function (geometry, winds, result, node, levels): of both winds."""
    load, mul, of_wind = t.ops.load_run, t.ops.mul, t.point and t.point.wind
    step = step_run(t.value, t.index, t.real, t.lanes)

    @no_type_check
    @wp.func
    def finish(geo: t.geometry, x: winds, result: t.rows(2), node: t.index, s: t.done):
        scale = load(geo.inverse_area, 0, node)
        rate_u = mul(scale, result[0])
        rate_v = mul(scale, result[1])
        if wp.static(t.rotation):
            f = load(geo.coriolis, 0, node)
            rate_u += mul(f, x.v)
            rate_v -= mul(f, x.u)
        if wp.static(of_wind is not None):
            more = of_wind(geo.point, ~node[0], geo.size, s.pushed)
            rate_u += more[0]
            rate_v += more[1]
        if wp.static(t.damped):
            rate_u += load(s.loss, 0, node)
            rate_v += load(s.loss, geo.size, node)
        step(s.now, s.past, 0, node, rate_u, s.tau, s.weights, s.out, s.pushed)
        step(s.now, s.past, geo.size, node, rate_v, s.tau, s.weights, s.out, s.pushed)

    return finish


@functools.cache
def level_kernels(
    unknowns: int, real: type, point: Pointwise, damped: bool, tracers: bool
) -> SimpleNamespace:
    """Kernels over nodes that step `depth` and `wind`, with the `structure` of the terms.

    depth: (places, inverse_area, stride, begin, N, count, local, c, levels): from the node `begin`
    on, out = now + tau (rate + loss) in the `count` blocks of depth and tracers, with the rates of
    `point` at the masses `carried` and the wind of `pushed`; then the combinations of
    `levels_struct`.
    wind: (places, inverse_area, stride, begin, N, local, c, levels): the same for both winds with
    the rates at `pushed`.
    `loss` is only read where `damped`.  Where `point` is a tangent all combinations are less
    `base`, and `carried` has those of the winds as well.
    """
    first, vector, gather = (unknowns - 1), wp.array(dtype=real), gather_sum(real)
    triple, place = wp.types.vector(3, real), entry_of(Contributors)
    entry, put, levels = entry_of(real), put_of(real), levels_struct(real)
    rates, moves, shifted = pointwise_sum(unknowns, real, point, 1), unknowns == 3, point.tangent
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
        begin: int,
        size: int,
        count: int,
        local: vector,
        c: structure,
        s: levels,
    ):
        i = begin + wp.tid()
        at = place(places, i)
        scale = entry(inverse_area, i)
        k = first * size + i
        rate = scale * gather(local, at, 0) + of_depth(c, i, size, s.pushed, s.carried)
        if wp.static(damped):
            rate += entry(s.loss, k)
        h = entry(s.now, k)
        h1 = entry(s.past, k)
        new = h + s.tau * rate
        put(s.carried, k, total(s.weights, new, h, h1, s.base, k))
        if wp.static(moves):
            put(s.pushed, k, total(s.mixes, new, h, h1, s.base, k))
        put(s.out, k, new)
        if wp.static(tracers):
            for block in range(1, count):
                k += size
                rate = scale * gather(local, at, block * stride)
                if wp.static(damped):
                    rate += entry(s.loss, k)
                h = entry(s.now, k)
                new = h + s.tau * rate
                put(s.carried, k, total(s.weights, new, h, entry(s.past, k), s.base, k))
                put(s.out, k, new)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def step_wind(
        places: wp.array(dtype=Contributors),
        inverse_area: vector,
        stride: int,
        begin: int,
        size: int,
        local: vector,
        c: structure,
        s: levels,
    ):
        i = begin + wp.tid()
        j = size + i
        at = place(places, i)
        scale = entry(inverse_area, i)
        wind = of_wind(c, i, size, s.pushed)
        rate_u = scale * gather(local, at, 0) + wind[0]
        rate_v = scale * gather(local, at, stride) + wind[1]
        if wp.static(damped):
            rate_u += entry(s.loss, i)
            rate_v += entry(s.loss, j)
        u = entry(s.now, i)
        v = entry(s.now, j)
        new_u = u + s.tau * rate_u
        new_v = v + s.tau * rate_v
        mixed_u = total(s.weights, new_u, u, entry(s.past, i), s.base, i)
        mixed_v = total(s.weights, new_v, v, entry(s.past, j), s.base, j)
        put(s.pushed, i, mixed_u)
        put(s.pushed, j, mixed_v)
        if wp.static(shifted):
            put(s.carried, i, mixed_u)
            put(s.carried, j, mixed_v)
        put(s.out, i, new_u)
        put(s.out, j, new_v)

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
