"""Sub-steps of linear gravity waves: DSS and the step of depth or wind in one pass."""

import functools
from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.access import gather_run
from swe_sphere.kernels.assembly import OPTIONS, Contributors


@functools.cache
def fast_wave_kernels(real: type, carries: bool) -> SimpleNamespace:
    """Kernels over N threads that move a state s (3N, ...) on in place, with constant rates.

    drift: (places, inverse_area, N, local, tau, rate, s, kept, path (2N,)): depth by the divergence
    that the elements left, and where it `carries`, path = kept path + tau V.
    kick: (places, inverse_area, stride, N, local, gravity, tau, rate, s): both winds by -gravity
    times the gradient that the elements left.
    """
    vector, gather = wp.array(dtype=real), gather_run(real, Contributors, real, 1)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def drift(
        places: wp.array(dtype=Contributors),
        inverse_area: vector,
        size: int,
        local: vector,
        tau: real,
        rate: vector,
        s: vector,
        kept: real,
        path: vector,
    ):
        i = wp.tid()
        k = 2 * size + i
        s[k] += tau * (inverse_area[i] * gather(local, places, i, 0) + rate[k])
        if wp.static(carries):
            j = size + i
            path[i] = kept * path[i] + tau * s[i]
            path[j] = kept * path[j] + tau * s[j]

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def kick(
        places: wp.array(dtype=Contributors),
        inverse_area: vector,
        stride: int,
        size: int,
        local: vector,
        gravity: real,
        tau: real,
        rate: vector,
        s: vector,
    ):
        i = wp.tid()
        j = size + i
        scale = -gravity * inverse_area[i]
        s[i] += tau * (scale * gather(local, places, i, 0) + rate[i])
        s[j] += tau * (scale * gather(local, places, i, stride) + rate[j])

    return SimpleNamespace(drift=drift, kick=kick)
