"""Pointwise formulas of the vector-invariant shallow-water equations, written once.

Both launch shapes call them: with plain numbers (one thread a node) or with SIMD registers that
hold one node of several elements (one thread a group of elements).

With the 2x2 matrix a[i, k] = dx/dxi_i . e_k (frame e_k, reference coordinates xi_i) and J = det a,
the covariant wind is u_i = a[i, k] V_k, and J times the contravariant wind as well as J times a
gradient need only the adjugate of a, so that no division is needed (formulas: Taylor & Fournier
2010, doi:10.1016/j.jcp.2010.04.008, section 4).
"""

from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.terms import Terms


def algebra(value: type, index: type, real: type, lanes: int) -> SimpleNamespace:
    """Loads and products for the number type `value`: a scalar (`lanes` 1) or a vector of lanes."""
    mul = wp.cw_mul if lanes > 1 else wp.mul

    @no_type_check
    @wp.func
    def load(x: wp.array(dtype=real), offset: int, node: index):
        if wp.static(lanes == 1):
            return x[offset + node]
        else:
            r = value(real(0.0))
            for lane in range(lanes):
                r[lane] = x[offset + node[lane]]
            return r

    @no_type_check
    @wp.func
    def dot(p: value, q: value, u: value, v: value):
        return mul(p, u) + mul(q, v)

    @no_type_check
    @wp.func
    def wedge(p: value, q: value, u: value, v: value):
        return mul(p, v) - mul(q, u)

    return SimpleNamespace(mul=mul, load=load, dot=dot, wedge=wedge)


def physics(
    terms: Terms, geometry: type, value: type, index: type, real: type, ops: SimpleNamespace
) -> SimpleNamespace:
    """Warp functions for the surface height, the Bernoulli function and the diffused fields."""
    load, dot = ops.load, ops.dot

    @no_type_check
    @wp.func
    def surface(geo: geometry, node: index, h: value):
        if wp.static(terms.bottom and not terms.tangent):
            return h + load(geo.bottom, 0, node)
        else:
            return h

    @no_type_check
    @wp.func
    def bernoulli(geo: geometry, u: value, v: value, height: value):
        r = value(real(0.0))
        if wp.static(terms.advection):
            r += real(0.5) * dot(u, v, u, v)
        if wp.static(terms.pressure):
            r += geo.gravity * height
        return r

    @no_type_check
    @wp.func
    def bernoulli_tangent(geo: geometry, u: value, v: value, du: value, dv: value, dh: value):
        r = value(real(0.0))
        if wp.static(terms.advection):
            r += dot(u, v, du, dv)
        if wp.static(terms.pressure):
            r += geo.gravity * dh
        return r

    @no_type_check
    @wp.func
    def diffused(geo: geometry, offset: int, node: index, x: value):
        r = value(real(0.0))
        if wp.static(terms.diffusion):
            r += geo.nu * x
        if wp.static(terms.biharmonic):
            r -= geo.nu4 * load(geo.laplacian, offset, node)
        return r

    return SimpleNamespace(
        surface=surface,
        bernoulli=bernoulli,
        bernoulli_tangent=bernoulli_tangent,
        diffused=diffused,
    )
