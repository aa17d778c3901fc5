"""Vectors of one number type from vectors of another."""

import functools
from typing import no_type_check

import warp as wp


@functools.cache
def convert_kernel(source: type, target: type) -> wp.Kernel:
    """Kernel (x (n,) of `source`, out (n,) of `target`): out = x, rounded."""

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False)
    def convert(x: wp.array(dtype=source), out: wp.array(dtype=target)) -> None:
        i = wp.tid()
        out[i] = target(x[i])

    return convert
