"""The leapfrog step and its filter in one pass over the state."""

import functools
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.access import entry_of, put_of


@functools.cache
def leapfrog_kernel(real: type) -> wp.Kernel:
    """Kernel (previous, state, tendency, two_dt, displacement, share): one filtered leapfrog step.

    With x- the filtered past, x the present and k the tendency, x+ = x- + 2 dt k and the
    displacement d = (nu/2)(x- - 2x + x+), where `displacement` is nu/2; `previous` becomes
    x + share d and `state` becomes x+ - (1 - share) d (Williams 2009, doi:10.1175/2009MWR2724.1,
    eqs. 7-9).
    """

    entry, put = entry_of(real), put_of(real)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False)
    def leapfrog(
        previous: wp.array(dtype=real),
        state: wp.array(dtype=real),
        tendency: wp.array(dtype=real),
        two_dt: real,
        displacement: real,
        share: real,
    ):
        i = wp.tid()
        x = entry(state, i)
        future = entry(previous, i) + two_dt * entry(tendency, i)
        d = displacement * (entry(previous, i) - real(2.0) * x + future)
        put(previous, i, x + share * d)
        put(state, i, future - (real(1.0) - share) * d)

    return leapfrog
