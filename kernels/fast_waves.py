"""Sub-steps of linear gravity waves: DSS and the step of depth or wind in one pass."""

import functools
from typing import Any

import warp as wp

from swe_sphere.kernels.define import kernel
from swe_sphere.kernels.simd.memory import Contributors, gather_of
from swe_sphere.kernels.simd.register import Register


@functools.cache
def fast_wave_kernels(real: Any, carries: bool) -> tuple[wp.Kernel, wp.Kernel]:
    """Return the kernels `drift` and `kick` over N nodes, which step a state s (3N, ...) in place.

    Both have constant rates.  `drift` steps the depth by the divergence that the elements left;
    where it carries, path = kept path + tau V, with the path (2N,).  `kick` steps both winds by
    -gravity times the gradient that the elements left.
    """
    vector, gather = wp.array(dtype=real), gather_of(Register(real))

    @kernel
    def drift(
        places: wp.array(dtype=Contributors), inverse_area: vector, size: int, local: vector,
        tau: real, rate: vector, s: vector, kept: real, path: vector,
    ):  # fmt: skip
        i = wp.tid()
        k = 2 * size + i
        s[k] += tau * (inverse_area[i] * gather(local, places, i, 0) + rate[k])
        if wp.static(carries):
            j = size + i
            path[i] = kept * path[i] + tau * s[i]
            path[j] = kept * path[j] + tau * s[j]

    @kernel
    def kick(
        places: wp.array(dtype=Contributors), inverse_area: vector, stride: int, size: int,
        local: vector, gravity: real, tau: real, rate: vector, s: vector,
    ):  # fmt: skip
        i = wp.tid()
        j = size + i
        scale = -gravity * inverse_area[i]
        s[i] += tau * (scale * gather(local, places, i, 0) + rate[i])
        s[j] += tau * (scale * gather(local, places, i, stride) + rate[j])

    return drift, kick
