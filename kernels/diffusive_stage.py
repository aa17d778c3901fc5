"""One stage of a stabilised Runge-Kutta method, in one pass over the state."""

import functools
from typing import no_type_check

import warp as wp


@functools.cache
def diffusive_stage_kernel(real: type) -> wp.Kernel:
    """Kernel (x, cx, y, cy, z, cz, rate, cr, first, cf, change, cc, out): their linear combination.

    All vectors (n,); `out` may be any of them.
    """
    vector = wp.array(dtype=real)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False)
    def diffusive_stage(
        x: vector,
        cx: real,
        y: vector,
        cy: real,
        z: vector,
        cz: real,
        rate: vector,
        cr: real,
        first: vector,
        cf: real,
        change: vector,
        cc: real,
        out: vector,
    ):
        i = wp.tid()
        kept = cx * x[i] + cy * y[i] + cz * z[i]
        out[i] = kept + (cr * rate[i] + cf * first[i] + cc * change[i])

    return diffusive_stage
