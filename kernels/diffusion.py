"""Dissipation at a point: weak Laplacians of wind (Hodge) and surface height, and the edge penalty.

The penalty acts on the jumps of vorticity zeta and divergence delta at the edges of elements, from
the values in each element to their weighted means over the elements that meet there. With a
coefficient gamma [m2 s-1], GLL weights W and area elements J, the weak form for a test wind w is

    -sum over elements and edge nodes of gamma W J [(zeta - mean) curl w + (delta - mean) div w].

The means are weighted with gamma W J, so that the operator is symmetric and negative semi-definite
even if gamma differs between elements. (Burman & Hansbo 2004, doi:10.1016/j.cma.2003.12.032,
penalise the jumps of gradients in this way.)
"""

import warp as wp

from swe_sphere.kernels.define import func, index, real, rows, value, vector
from swe_sphere.kernels.dynamics import surface_height
from swe_sphere.kernels.formulas import Formula, no_wind, none, pair, two_rows, winds_at
from swe_sphere.kernels.metric import contravariant_flux, covariant_wind, curl, divergence, gradient
from swe_sphere.kernels.simd.arithmetic import mul
from swe_sphere.kernels.simd.memory import load_nodes
from swe_sphere.kernels.terms import Terms, geometry, local, np_


def diffusion(terms: Terms, height: bool, wind: bool) -> Formula:
    """Return the weak Laplacian of the surface height, of the wind or of both.

    The weak Laplacian is -(grad phi, grad s) of the surface height s for each nodal test function
    phi, and -(div w, div V) - (curl w, curl V) of the wind V for each nodal test wind w. `fluxes`
    returns the rows for the transposed derivatives t1 and t2; `result` (geometry, t1, t2, e, n,
    out) returns the weak Laplacian plus the values of `out`, if that holds the other terms.
    """
    fields, at_div, at_curl = height + 2 * wind, int(height), height + 1
    kind, adds, last = rows(fields), terms.dynamics, terms.unknowns - 1
    surface, first = surface_height(terms), 0 if wind else last

    @func
    def scaled(geo: geometry, offset: int, node: index, x: value):
        r = value(real(0.0))
        if wp.static(terms.diffusion):
            r += geo.nu * x
        if wp.static(terms.biharmonic):
            r -= geo.nu4 * load_nodes(geo.laplacian, offset, node)
        return r

    @func
    def operands(geo: geometry, w: none, a: vector, x: vector, at: int, e: int, n: int):
        node = geo.nodes[e, n]
        r1 = kind()
        r2 = kind()
        if wp.static(height):
            h = last * geo.size
            s = scaled(geo, h, node, surface(geo, node, load_nodes(x, h, node)))
            r1[0] = s
            r2[0] = s
        if wp.static(wind):
            u = scaled(geo, 0, node, load_nodes(x, 0, node))
            v = scaled(geo, geo.size, node, load_nodes(x, geo.size, node))
            f1, f2 = contravariant_flux(geo.basis, e, n, u, v)
            u1, u2 = covariant_wind(geo.basis, e, n, u, v)
            r1[at_div] = f1
            r1[at_curl] = u2
            r2[at_div] = f2
            r2[at_curl] = u1
        return r1, r2

    @func
    def fluxes(geo: geometry, d1: kind, d2: kind, e: int, n: int):
        w = geo.weight[n // np_, n % np_] * geo.inverse_jacobian[e, n]
        f1 = kind()
        f2 = kind()
        if wp.static(height):
            u, v = gradient(geo.basis, e, n, d1[0], d2[0])
            g1, g2 = contravariant_flux(geo.basis, e, n, u, v)
            f1[0] = mul(w, g1)
            f2[0] = mul(w, g2)
        if wp.static(wind):
            div = mul(w, divergence(d1[at_div], d2[at_div]))
            zeta = mul(w, curl(d1[at_curl], d2[at_curl]))
            f1[at_div] = div
            f1[at_curl] = zeta
            f2[at_div] = div
            f2[at_curl] = zeta
        return f1, f2

    @func
    def result(geo: geometry, t1: kind, t2: kind, e: int, n: int, out: local):
        r = kind()
        if wp.static(height):
            r[fields - 1] = -divergence(t1[0], t2[0])
        if wp.static(wind):
            gu, gv = gradient(geo.basis, e, n, t1[at_div], t2[at_div])
            cu, cv = gradient(geo.basis, e, n, t1[at_curl], t2[at_curl])
            r[0] = cv - gu
            r[1] = -gv - cu
        if wp.static(adds):
            for k in range(fields):
                r[k] = r[k] + out[e, n, first + k]
        return r

    return Formula(none, no_wind, kind, operands, result, fields, not wind, fluxes=fluxes)


winds, load_winds = winds_at(own=True, base=False)


@func
def _wind_components(geo: geometry, w: winds, a: vector, x: vector, at: int, e: int, n: int):
    f1, f2 = contravariant_flux(geo.basis, e, n, w[0], w[1])
    u1, u2 = covariant_wind(geo.basis, e, n, w[0], w[1])
    return two_rows(f1, u2), two_rows(f2, u1)


@func
def _weighted(geo: geometry, w: winds, d1: pair, d2: pair, e: int, n: int):
    weight = geo.weight[n // np_, n % np_] * geo.strength[e, n]
    return two_rows(mul(weight, divergence(d1[0], d2[0])), mul(weight, curl(d1[1], d2[1])))


derivatives = Formula(winds, load_winds, pair, _wind_components, _weighted, 2, edges_only=True)
"""Formula of gamma W J times divergence and vorticity of the wind x at edges of elements."""


@func
def _jumps(geo: geometry, w: none, a: vector, x: vector, at: int, e: int, n: int):
    node = geo.nodes[e, n]
    weight = geo.weight[n // np_, n % np_] * geo.strength[e, n]
    r = pair()
    for k in range(2):
        mean = load_nodes(x, k * geo.size, node)
        r[k] = mul(geo.inverse_jacobian[e, n], geo.values[e, n, k]) - mul(weight, mean)
    return r, r


@func
def _weak(geo: geometry, w: none, d1: pair, d2: pair, e: int, n: int):
    gu, gv = gradient(geo.basis, e, n, d1[0], d2[0])
    cu, cv = gradient(geo.basis, e, n, d1[1], d2[1])
    return two_rows(cv - gu, -gv - cu)


weak_form = Formula(none, no_wind, pair, _jumps, _weak, 2, is_scalar=True)
"""Weak form of `geometry.values` (the result of the kernel of `derivatives`) and the means x (2N,).

`geometry.derivative` is the transposed derivative matrix.
"""
