"""One stage of a stabilised Runge-Kutta method, in one pass over the state."""

import functools
from typing import no_type_check

import warp as wp


@functools.cache
def diffusive_stage_kernel(real: type) -> wp.Kernel:
    """Kernel (x, last, cl, before, cb, rate, cr, first, cf, slope, cs, change, y), vectors (n,).

    change = cl last + cb before + cr rate + cf first + cs slope and y = x + change; both may be any
    of what they are made of.
    """
    vector = wp.array(dtype=real)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False)
    def diffusive_stage(
        x: vector,
        last: vector,
        cl: real,
        before: vector,
        cb: real,
        rate: vector,
        cr: real,
        first: vector,
        cf: real,
        slope: vector,
        cs: real,
        change: vector,
        y: vector,
    ):
        i = wp.tid()
        d = cl * last[i] + cb * before[i] + (cr * rate[i] + cf * first[i] + cs * slope[i])
        y[i] = x[i] + d
        change[i] = d

    return diffusive_stage
