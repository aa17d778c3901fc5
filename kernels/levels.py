"""Time levels as the passes of a step take them, and the step of a run of nodes in registers."""

import functools
from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.access import step_run


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
    load, mul = t.ops.load_run, t.ops.mul
    step = step_run(t.value, t.index, t.real, t.lanes)

    @no_type_check
    @wp.func
    def finish(geo: t.geometry, s: t.done, k: int, at: int, node: t.index, result: t.value):
        rate = mul(load(geo.inverse_area, 0, node), result)
        if wp.static(moves) and k == 0:  # first, as `out` may be a level, which is gone then
            step(s.now, s.past, at, node, rate, s.tau, s.mixes, s.pushed, s.pushed)
        step(s.now, s.past, at, node, rate, s.tau, s.weights, s.out, s.carried)

    return finish


def finish_wind(t: SimpleNamespace, winds: type) -> wp.Function:
    """Function (geometry, winds, result, node, levels): of both winds."""
    load, mul = t.ops.load_run, t.ops.mul
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
        step(s.now, s.past, 0, node, rate_u, s.tau, s.weights, s.out, s.pushed)
        step(s.now, s.past, geo.size, node, rate_v, s.tau, s.weights, s.out, s.pushed)

    return finish
