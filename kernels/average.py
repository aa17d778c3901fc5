"""Averages of the energy's gradient between two states, node by node."""

import functools
from typing import Any

import warp as wp

from swe_sphere.kernels.define import func, kernel, struct_of


@functools.cache
def average_kernel(real: Any, bottom: bool) -> tuple[wp.Kernel, Any]:
    """Return the kernel that averages the energy's gradient between two states, and its structure.

    The arguments are (structure, first, last, mean, base), all states (3N,): terms of the skew
    form.  With F and B the averages of hV and |V|²/2 + g(h + b), the derivatives of the energy by V
    and h, along the straight line from `first` to `last`: `mean` becomes (wind half way, B) and
    `base` (F / h, h), h the depth half way.  The energy is cubic, so these formulas are exact.  The
    structure holds `size` N, `gravity` [m s-2] and, with a bottom, its height `bottom` (N,) [m].
    """
    vector = wp.array(dtype=real)
    members: dict[str, Any] = {"size": wp.int32, "gravity": real}
    if bottom:
        members["bottom"] = vector
    constants = struct_of("Constants", members)

    @func
    def flux(h0: real, u0: real, h1: real, u1: real):
        sixth = real(1.0) / real(6.0)
        return sixth * (real(2.0) * (h0 * u0 + h1 * u1) + h0 * u1 + h1 * u0)

    @func
    def square(u0: real, u1: real):
        return (u0 * u0 + u0 * u1 + u1 * u1) / real(6.0)

    @kernel
    def average(c: constants, first: vector, last: vector, mean: vector, base: vector):
        i = wp.tid()
        j = c.size + i
        k = 2 * c.size + i
        half = real(0.5)
        h = half * (first[k] + last[k])
        height = h
        if wp.static(bottom):
            height += c.bottom[i]
        mean[i] = half * (first[i] + last[i])
        mean[j] = half * (first[j] + last[j])
        mean[k] = c.gravity * height + square(first[i], last[i]) + square(first[j], last[j])
        base[i] = flux(first[k], first[i], last[k], last[i]) / h
        base[j] = flux(first[k], first[j], last[k], last[j]) / h
        base[k] = h

    return average, constants
