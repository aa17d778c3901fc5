"""One equation after the other: time levels, DSS, the step, and what is differentiated next.

Continuity and momentum are each stepped at a node once its rate is known (`run_steps.py`): its
field moves on, and combinations of the time levels are left for the elements to differentiate next,
so that no level is read for that alone.
"""

import functools
from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.access import entry_of, put_of, run_of, step_run


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


def finish_mass(t: SimpleNamespace, moves: bool, shifted: bool = False) -> wp.Function:
    """Function (geometry, levels, k, offset, node, result): of the k-th mass; the depth first.

    moves: whether the depth pushes the wind.  Where it is `shifted`, combinations are less `base`.
    """
    load, mul, of_depth = run_of(t.value, t.real, t.lanes), t.ops.mul, t.point.depth
    step = step_run(t.value, t.real, t.lanes, shifted)

    @no_type_check
    @wp.func
    def finish(geo: t.geometry, s: t.done, k: int, offset: int, node: int, result: t.value):
        rate = mul(load(geo.inverse_area, node), result)
        at = offset + node
        if k == 0:
            rate += of_depth(geo.point, node, geo.size, s.pushed, s.carried)
        if wp.static(t.damped):
            rate += load(s.loss, at)
        if wp.static(moves) and k == 0:  # first, as `out` may be a level, which is gone then
            step(s.now, s.past, at, rate, s.tau, s.mixes, s.base, s.pushed, s.pushed)
        step(s.now, s.past, at, rate, s.tau, s.weights, s.base, s.out, s.carried)

    return finish


def finish_wind(t: SimpleNamespace, shifted: bool = False) -> wp.Function:
    """Function (geometry, result, node, levels): of both winds; `carried` has them if `shifted`."""
    load, mul, of_wind = run_of(t.value, t.real, t.lanes), t.ops.mul, t.point.wind
    step = step_run(t.value, t.real, t.lanes, shifted)

    @no_type_check
    @wp.func
    def finish(geo: t.geometry, result: t.rows(2), node: int, s: t.done):
        scale = load(geo.inverse_area, node)
        more = of_wind(geo.point, node, geo.size, s.pushed)
        for k in range(2):
            at = k * geo.size + node
            rate = mul(scale, result[k]) + more[k]
            if wp.static(t.damped):
                rate += load(s.loss, at)
            if wp.static(shifted):
                step(s.now, s.past, at, rate, s.tau, s.weights, s.base, s.carried, s.carried)
            step(s.now, s.past, at, rate, s.tau, s.weights, s.base, s.out, s.pushed)

    return finish


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
