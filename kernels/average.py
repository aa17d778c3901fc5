"""Averages of the energy's gradient between two states, at each node."""

import functools
from typing import Any

import warp as wp

from swe_sphere.kernels.define import func, kernel, real, vector


@func
def flux(h0: real, u0: real, h1: real, u1: real):
    return real(1.0) / real(6.0) * (real(2.0) * (h0 * u0 + h1 * u1) + h0 * u1 + h1 * u0)


@func
def half_square(u0: real, u1: real):
    return (u0 * u0 + u0 * u1 + u1 * u1) / real(6.0)


@functools.cache
def average_kernel(has_bottom: bool) -> Any:
    """Return the kernel that averages the energy's gradient between two states.

    All states are (3N,), `mean` and `base` those of the skew form. F and B are the averages
    of hV and |V|²/2 + g(h + b), the derivatives of the energy with respect to V and h, along the
    straight line from `first` to `last`. The kernel stores (wind half way, B) in `mean` and (F / h,
    h) in `base`, where h is the depth half way. The energy is cubic, so these formulas are exact.
    The bottom height b (N,) [m] is read only if the scene has a bottom.
    """

    @kernel
    def average(
        size: int, gravity: real, bottom: vector, first: vector, last: vector, mean: vector,
        base: vector,
    ):  # fmt: skip
        i = wp.tid()
        j = size + i
        k = 2 * size + i
        half = real(0.5)
        h = half * (first[k] + last[k])
        height = h
        if wp.static(has_bottom):
            height += bottom[i]
        mean[i] = half * (first[i] + last[i])
        mean[j] = half * (first[j] + last[j])
        mean[k] = gravity * height + half_square(first[i], last[i]) + half_square(first[j], last[j])
        base[i] = flux(first[k], first[i], last[k], last[i]) / h
        base[j] = flux(first[k], first[j], last[k], last[j]) / h
        base[k] = h

    return average
