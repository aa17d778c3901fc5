"""Nodal steps of the block elimination of the linearised equations, fused with DSS.

With tau the implicit step, T = (I + tau f k x)^-1 and the depth H, elimination of the wind leaves
S = I - tau^2 g D H T G for the depth, with the discrete, DSS'd gradient G and divergence D.
"""

import functools
from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.assembly import OPTIONS, Contributors, gather_sum


@functools.cache
def elimination_kernels(real: type, given: type) -> SimpleNamespace:
    """Kernels over the N nodes; `real` is the type inside, `given` that of the state vectors.

    Common arguments, all (N,): `places_1` and `places_2` (contributors in local tendencies of one
    and of two fields), `inverse_area` [m-2], `depth` H [m], `same` = 1/(1 + tau^2 f^2) and
    `cross` = tau f/(1 + tau^2 f^2), the entries of T.
    """
    vector, state = wp.array(dtype=real), wp.array(dtype=given)
    places = wp.array(dtype=Contributors)
    gather = gather_sum(real)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def turned_flux(depth: vector, same: vector, cross: vector, size: int, r: state, flux: vector):
        node = wp.tid()
        u = real(r[node])
        v = real(r[size + node])
        flux[node] = depth[node] * (same[node] * u + cross[node] * v)
        flux[size + node] = depth[node] * (same[node] * v - cross[node] * u)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def eliminated(
        places_1: places,
        inverse_area: vector,
        size: int,
        local: vector,
        r: state,
        tau: real,
        b: vector,
    ):
        node = wp.tid()
        divergence = inverse_area[node] * gather(local, places_1[node], 0)
        b[node] = real(r[2 * size + node]) - tau * divergence

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def gradient_flux(
        places_2: places,
        inverse_area: vector,
        depth: vector,
        same: vector,
        cross: vector,
        stride: int,
        size: int,
        local: vector,
        flux: vector,
    ):
        node = wp.tid()
        scale = depth[node] * inverse_area[node]
        u = scale * gather(local, places_2[node], 0)
        v = scale * gather(local, places_2[node], stride)
        flux[node] = same[node] * u + cross[node] * v
        flux[size + node] = same[node] * v - cross[node] * u

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def substituted(
        places_2: places,
        inverse_area: vector,
        same: vector,
        cross: vector,
        stride: int,
        size: int,
        local: vector,
        r: state,
        h: vector,
        tau_g: real,
        out: state,
    ):
        node = wp.tid()
        scale = tau_g * inverse_area[node]
        u = real(r[node]) - scale * gather(local, places_2[node], 0)
        v = real(r[size + node]) - scale * gather(local, places_2[node], stride)
        out[node] = given(same[node] * u + cross[node] * v)
        out[size + node] = given(same[node] * v - cross[node] * u)
        out[2 * size + node] = given(h[node])

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def chebyshev(
        places_1: places,
        inverse_area: vector,
        inverse_diagonal: vector,
        local: vector,
        tau_tau_g: real,
        keep: real,
        take: real,
        beta: real,
        r: vector,
        d: vector,
        x: vector,
    ):
        node = wp.tid()
        divergence = inverse_area[node] * gather(local, places_1[node], 0)
        residual = r[node] - (d[node] - tau_tau_g * divergence)
        step = keep * d[node] + take * inverse_diagonal[node] * residual
        r[node] = residual
        d[node] = step
        x[node] = x[node] + beta * step

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def chebyshev_start(
        inverse_diagonal: vector, take: real, beta: real, r: vector, d: vector, x: vector
    ):
        node = wp.tid()
        step = take * inverse_diagonal[node] * r[node]
        d[node] = step
        x[node] = beta * step

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def schur(
        places_1: places,
        inverse_area: vector,
        local: vector,
        tau_tau_g: real,
        d: vector,
        out: vector,
    ):
        node = wp.tid()
        divergence = inverse_area[node] * gather(local, places_1[node], 0)
        out[node] = d[node] - tau_tau_g * divergence

    return SimpleNamespace(
        turned_flux=turned_flux,
        eliminated=eliminated,
        gradient_flux=gradient_flux,
        substituted=substituted,
        chebyshev=chebyshev,
        chebyshev_start=chebyshev_start,
        schur=schur,
    )
