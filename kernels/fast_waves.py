"""Sub-steps of linear gravity waves: DSS and the step of depth or wind in one pass.

The kernels run over N nodes and step a state s (3N, ...) in place, with constant rates.
"""

import warp as wp

from swe_sphere.kernels.define import kernel, real, vector
from swe_sphere.kernels.simd.memory import Places, gather


@kernel
def drift(
    places: Places, inverse_area: vector, size: int, local: vector, tau: real, rate: vector,
    s: vector, carries: int, kept: real, path: vector,
):  # fmt: skip
    """Step the depth by the divergence that the elements left.

    If `carries` is 1, path = kept path + tau V, with the path (2N,).
    """
    i = wp.tid()
    k = 2 * size + i
    s[k] += tau * (inverse_area[i] * gather(local, places, i, 0) + rate[k])
    if carries == 1:
        j = size + i
        path[i] = kept * path[i] + tau * s[i]
        path[j] = kept * path[j] + tau * s[j]


@kernel
def kick(
    places: Places, inverse_area: vector, stride: int, size: int, local: vector, gravity: real,
    tau: real, rate: vector, s: vector,
):  # fmt: skip
    """Step both winds by -gravity times the gradient that the elements left."""
    i = wp.tid()
    j = size + i
    scale = -gravity * inverse_area[i]
    s[i] += tau * (scale * gather(local, places, i, 0) + rate[i])
    s[j] += tau * (scale * gather(local, places, i, stride) + rate[j])
