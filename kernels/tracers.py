"""Node-by-node algebra between the depth and blocks of tracer mass in state vectors.

A tracer with mixing ratio q has the mass hq per unit area, which the wind carries exactly as it
carries the depth h, formulas and rounding included, so that q = 1 has the tendency of h. State
vectors x hold h from the offset `depth` on and, from the offset `first` on, one block (N,) of hq
per tracer; kernels run over (tracers, N) threads unless stated otherwise.
"""

import warp as wp

from swe_sphere.kernels.assembly import store_stage_of_field
from swe_sphere.kernels.define import kernel, real, value, vector
from swe_sphere.kernels.formulas import single
from swe_sphere.kernels.metric import contravariant_flux, jacobian
from swe_sphere.kernels.simd.arithmetic import div, mul
from swe_sphere.kernels.simd.memory import load_nodes
from swe_sphere.kernels.simd.stages import stage
from swe_sphere.kernels.terms import geometry, np_


@kernel
def mixing_ratio(x: vector, depth: int, first: int, size: int, q: vector):
    """Set q = hq / h."""
    k, node = wp.tid()
    at = k * size + node
    q[at] = x[first + at] / x[depth + node]


@kernel
def follow(r: vector, x: vector, q: vector, depth: int, first: int, size: int):
    """Set x_hq = r_hq + q (x_h - r_h)."""
    k, node = wp.tid()
    at = k * size + node
    x[first + at] = r[first + at] + q[at] * (x[depth + node] - r[depth + node])


@kernel
def correct(
    q: vector, rates: vector, depth_rate: vector, factor: real, depth: int, first: int, size: int,
    r: vector, x: vector,
):  # fmt: skip
    """Set x_hq = r_hq + q (x_h - r_h) + factor (rates - q depth_rate).

    rates (count*N,) are -div(q F) of a mass flux F, and depth_rate (N,) is -div F.
    """
    k, node = wp.tid()
    at = k * size + node
    change = q[at] * (x[depth + node] - r[depth + node])
    x[first + at] = r[first + at] + change + factor * (rates[at] - q[at] * depth_rate[node])


@kernel
def surface(x: vector, bottom: vector, depth: int, first: int, size: int, out: vector):
    """Set out = hq (1 + b/h) = q (h + b), the field that diffusion smooths."""
    k, node = wp.tid()
    at = k * size + node
    out[at] = x[first + at] * (real(1.0) + bottom[node] / x[depth + node])


@kernel
def surface_tangent(
    base: vector, bottom: vector, depth: int, first: int, size: int, x: vector, out: vector
):
    """Store the derivative of `surface` at `base` along x."""
    k, node = wp.tid()
    at = k * size + node
    h = base[depth + node]
    slope = bottom[node] / h
    lost = base[first + at] * slope / h * x[depth + node]
    out[at] = x[first + at] * (real(1.0) + slope) - lost


@kernel
def mass_flux(wind: vector, x: vector, depth: int, size: int, first: int, s: stage, out: vector):
    """Apply stage s to the flux h V of wind[:2N] and x[depth:] at N nodes, into out[first:]."""
    node = wp.tid()
    h = x[depth + node]
    store_stage_of_field(s, first + node, 0, single(h * wind[node]), out)
    store_stage_of_field(s, first + size + node, 0, single(h * wind[size + node]), out)


@kernel
def courant_rates(geo: geometry, flux: vector, depth: vector, out: wp.array(dtype=value)):
    """Store the maximum over the nodes of each element of |d xi_1/dt| + |d xi_2/dt| [s-1].

    These are the speeds of the wind flux (2N,) / depth (N,) in the reference coordinates, in
    which the sides of an element have length 2. Runs over groups.
    """
    e = wp.tid()
    most = value(real(0.0))
    for n in range(np_ * np_):
        node = geo.nodes[e, n]
        u, v = load_nodes(flux, 0, node), load_nodes(flux, geo.size, node)
        one, two = contravariant_flux(geo.basis, e, n, u, v)
        volume = mul(jacobian(geo.basis, e, n), load_nodes(depth, 0, node))
        most = wp.max(most, div(wp.abs(one) + wp.abs(two), volume))
    out[e] = most
