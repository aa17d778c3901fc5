"""Rates of change as the stage of a step takes them: nothing but the next state is written.

With the levels Y_k of a step that begins at y, an explicit Runge-Kutta method is a chain of sums
y + tau K + sum_k w_k (Y_k - y) of one rate K each (the form of Shu & Osher 1988), so that no rate
has to be stored and read again.  Differences to y keep what sums of weighted states would lose.
"""

import functools
from typing import Any, no_type_check

import warp as wp

from swe_sphere.kernels.registers import run_type


@functools.cache
def stage_struct(real: type) -> type:
    """Warp structure of a stage: `start` (n,) and `tau` [s].  Where it is not `on`, rates stay."""
    members = {"on": wp.bool, "tau": real, "start": wp.array(dtype=real)}
    structure: type = wp.struct(type("Stage", (), {"__annotations__": members}))
    return structure


def node_types(real: type, lanes: int = 1, fields: int = 1) -> tuple[type, type]:
    """Types of a node's value, or of `lanes` in a register, and of so many of them in rows."""
    value = wp.types.vector(lanes, real) if lanes > 1 else real
    if fields == 1:
        return value, value
    one = lanes == 1
    return value, wp.types.vector(fields, real) if one else wp.types.matrix((fields, lanes), real)


@functools.cache
def leave_of(rows: type, real: type, lanes: int = 1, fields: int = 1) -> Any:
    """Warp function (stage, at, size, rates, out): out[at] = start[at] + tau rate, or the rate.

    Of so many fields, `size` apart, of a node or of a run of nodes that fill a register.  A
    statement has one operation, so that none are contracted.
    """
    _, register = run_type(real, lanes)
    stage, vector = stage_struct(real), wp.array(dtype=real)

    @wp.func_native(f"""
        {register}
        typedef run* runs;
        for (int f = 0; f < {fields}; ++f, at += size) {{
            run r = runs(&rates)[f];
            if (s.on) {{
                r *= s.tau;
                r += *runs(s.start.data + at);
            }}
            *runs(out.data + at) = r;
        }}
    """)
    def leave(s: stage, at: int, size: int, rates: rows, out: vector): ...

    return leave


@functools.cache
def mix_kernel(real: type, lanes: int) -> wp.Kernel:
    """Kernel (n, start, levels (m, n), weights (m,), first, last, out), out another array.

    out = start + sum_k w_k (levels_k - start) with first <= k < last, over runs of `lanes` numbers;
    the last of them may overlap the one before.
    """
    _, register = run_type(real, lanes)
    vector, matrix = wp.array(dtype=real), wp.array2d(dtype=real)

    @wp.func_native(f"""
        {register}
        typedef run* runs;
        const run start = *runs(x.data + at);
        run sum = start;
        for (int k = first; k < last; ++k) {{
            run change = *runs(levels.data + size_t(k) * levels.shape[1] + at);
            change -= start;
            change *= weights.data[k];
            sum += change;
        }}
        *runs(out.data + at) = sum;
    """)
    def mix_run(
        x: vector, levels: matrix, weights: vector, first: int, last: int, at: int, out: vector
    ): ...

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False)
    def mix(n: int, x: vector, levels: matrix, weights: vector, first: int, last: int, out: vector):
        mix_run(x, levels, weights, first, last, wp.min(lanes * wp.tid(), n - lanes), out)

    return mix


@functools.cache
def diffusive_stage_kernel(real: type, lanes: int) -> wp.Kernel:
    """Kernel (begin, x, last, cl, before, cb, rate, cr, first, cf, slope, cs, change, y).

    Of vectors (n,), over runs of `lanes` numbers from `begin` on: change = cl last + cb before +
    cr rate + cf first + cs slope and y = x + change; both may be any of what they are made of.
    """
    _, register = run_type(real, lanes)
    vector = wp.array(dtype=real)

    @wp.func_native(f"""
        {register}
        const auto scaled = [&](const auto& v, auto c) {{
            run r = *reinterpret_cast<const run*>(v.data + at);
            r *= c;
            return r;
        }};
        run d = scaled(last, cl), r = scaled(rate, cr);
        d += scaled(before, cb);
        r += scaled(first, cf);
        r += scaled(slope, cs);
        d += r;
        r = *reinterpret_cast<const run*>(x.data + at);
        r += d;
        *reinterpret_cast<run*>(y.data + at) = r;
        *reinterpret_cast<run*>(change.data + at) = d;
    """)
    def stage_run(
        at: int, x: vector, last: vector, cl: real, before: vector, cb: real, rate: vector,
        cr: real, first: vector, cf: real, slope: vector, cs: real, change: vector, y: vector,
    ): ...  # fmt: skip

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False)
    def diffusive_stage(
        begin: int, x: vector, last: vector, cl: real, before: vector, cb: real, rate: vector,
        cr: real, first: vector, cf: real, slope: vector, cs: real, change: vector, y: vector,
    ):  # fmt: skip
        at = begin + lanes * wp.tid()
        stage_run(at, x, last, cl, before, cb, rate, cr, first, cf, slope, cs, change, y)

    return diffusive_stage
