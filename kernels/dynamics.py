"""The vector-invariant shallow-water equations at a point, as a whole and in parts.

The equations are quadratic, so the tangent at a state along a direction is the same sum with each
product replaced by its derivative.
"""

import functools
from typing import Any

import warp as wp

from swe_sphere.kernels.define import func, index, real, rows, value, vector
from swe_sphere.kernels.formulas import Formula, no_wind, none, row, single, two_rows, winds_at
from swe_sphere.kernels.metric import contravariant_flux, covariant_wind, curl, divergence, dot
from swe_sphere.kernels.metric import gradient as grad
from swe_sphere.kernels.simd.arithmetic import mul
from swe_sphere.kernels.simd.memory import load_nodes
from swe_sphere.kernels.terms import Terms, geometry, np_


@functools.cache
def transport(tangent: bool = False, alone: bool = False) -> Formula:
    """Return the formula of -div(m V), with m = x[at:] and the wind V of a.

    The tangent is -div(m' V + m V'), with (V, m) of the state a and (V', m') of x. Both are
    rounded as in `vector_invariant`. alone: the kernel has one field m, so that the winds are
    loaded with it.
    """
    (winds, load_winds), first = winds_at(own=tangent, base=not alone), 2 * tangent

    @func
    def operands(geo: geometry, w: winds, a: vector, x: vector, at: int, e: int, n: int):
        node = geo.nodes[e, n]
        m = load_nodes(x, at, node)
        if wp.static(alone):
            fu = mul(m, load_nodes(a, 0, node))
            fv = mul(m, load_nodes(a, geo.size, node))
        else:
            fu = mul(m, w[first])
            fv = mul(m, w[first + 1])
        if wp.static(tangent):
            mb = load_nodes(a, at, node)
            fu = mul(mb, w[0]) + fu
            fv = mul(mb, w[1]) + fv
        f1, f2 = contravariant_flux(geo.basis, e, n, fu, fv)
        return row(f1), row(f2)

    @func
    def result(geo: geometry, w: winds, d1: single, d2: single, e: int, n: int):
        return row(-geo.weight[n // np_, n % np_] * divergence(d1[0], d2[0]))

    return Formula(winds, load_winds, single, operands, result, 1, shares_winds=not alone)


@func
def _field(geo: geometry, w: none, a: vector, x: vector, at: int, e: int, n: int):
    s = row(load_nodes(x, at, geo.nodes[e, n]))
    return s, s


@func
def _slope(geo: geometry, w: none, d1: single, d2: single, e: int, n: int):
    weight = geo.weight[n // np_, n % np_]
    east, north = grad(geo.basis, e, n, d1[0], d2[0])
    return two_rows(weight * east, weight * north)


gradient = Formula(none, no_wind, single, _field, _slope, 2, is_scalar=True)
"""Formula of grad s for the field s at the offset `at` of x."""


def vector_invariant(terms: Terms) -> Formula:
    """Return the formula of -zeta k x V - grad B and -div(h V), with B = |V|²/2 + g (h + b).

    In the skew form V and h are wind and depth of the state a, and B is the field that x stores in
    place of its depth; zeta remains the vorticity of the wind of x. See `Terms.skew`.
    """
    winds, load_winds = winds_at(own=True, base=terms.skew)
    kind, parts, rates = _equations(terms, curls=1)
    surface, last, first = surface_height(terms), 2 - terms.momentum, 2 * terms.skew

    @func
    def operands(geo: geometry, w: winds, a: vector, x: vector, at: int, e: int, n: int):
        node = geo.nodes[e, n]
        h = load_nodes(x, 2 * geo.size, node)
        head = value(real(0.0))
        if wp.static(terms.skew):
            head = h
            h = load_nodes(a, 2 * geo.size, node)
        elif wp.static(terms.advection):
            head = real(0.5) * dot(w[0], w[1], w[0], w[1])
        if wp.static(terms.pressure and not terms.skew):
            head += geo.gravity * surface(geo, node, h)
        return parts(geo, e, n, head, mul(h, w[first]), mul(h, w[first + 1]), w[0], w[1])

    @func
    def result(geo: geometry, w: winds, d1: kind, d2: kind, e: int, n: int):
        if wp.static(terms.advection):
            zeta = curl(d1[last], d2[last])
            return rates(geo, d1, d2, e, n, mul(zeta, w[first + 1]), mul(zeta, w[first]))
        else:
            return rates(geo, d1, d2, e, n, value(real(0.0)), value(real(0.0)))

    return Formula(winds, load_winds, kind, operands, result, 3 - terms.momentum, needs_winds=True)


def tangent(terms: Terms) -> Formula:
    """Return the formula of the derivative of `vector_invariant` at the state a along x."""
    winds, load_winds = winds_at(own=True, base=True)
    kind, parts, rates = _equations(terms, curls=2)
    last = 2 - terms.momentum

    @func
    def operands(geo: geometry, w: winds, a: vector, x: vector, at: int, e: int, n: int):
        node = geo.nodes[e, n]
        h = load_nodes(x, 2 * geo.size, node)
        hb = load_nodes(a, 2 * geo.size, node)
        head = value(real(0.0))
        if wp.static(terms.advection):
            head = dot(w[2], w[3], w[0], w[1])
        if wp.static(terms.pressure):
            head += geo.gravity * h
        fu = mul(hb, w[0]) + mul(h, w[2])
        fv = mul(hb, w[1]) + mul(h, w[3])
        r1, r2 = parts(geo, e, n, head, fu, fv, w[0], w[1])
        if wp.static(terms.advection):
            u1, u2 = covariant_wind(geo.basis, e, n, w[2], w[3])
            r1[last + 1] = u2
            r2[last + 1] = u1
        return r1, r2

    @func
    def result(geo: geometry, w: winds, d1: kind, d2: kind, e: int, n: int):
        if wp.static(terms.advection):
            zeta = curl(d1[last], d2[last])
            zeta_base = curl(d1[last + 1], d2[last + 1])
            tu = mul(zeta_base, w[1]) + mul(zeta, w[3])
            tv = mul(zeta_base, w[0]) + mul(zeta, w[2])
            return rates(geo, d1, d2, e, n, tu, tv)
        else:
            return rates(geo, d1, d2, e, n, value(real(0.0)), value(real(0.0)))

    return Formula(winds, load_winds, kind, operands, result, 3 - terms.momentum, needs_winds=True)


def _equations(terms: Terms, curls: int) -> tuple[Any, Any, Any]:
    """Return the row type of the momentum and continuity equations, and `parts` and `rates`.

    The rows are B, the flux of the continuity equation, and `curls` winds if there is advection.
    `parts` (geometry, e, n, head, fu, fv, u, v) fills the rows except a second wind, with head = B.
    `rates` (geometry, d1, d2, e, n, tu, tv) returns rates of V (advection adds tu, -tv) and h.
    """
    mass, advection, last = not terms.momentum, terms.advection, 2 - terms.momentum
    kind, fields = rows(last + advection * curls), rows(2 + mass)

    @func
    def parts(geo: geometry, e: int, n: int, head: value, fu: value, fv: value, u: value, v: value):
        r1 = kind()
        r2 = kind()
        r1[0] = head
        r2[0] = head
        if wp.static(mass):
            f1, f2 = contravariant_flux(geo.basis, e, n, fu, fv)
            r1[1] = f1
            r2[1] = f2
        if wp.static(advection):
            u1, u2 = covariant_wind(geo.basis, e, n, u, v)
            r1[last] = u2
            r2[last] = u1
        return r1, r2

    @func
    def rates(geo: geometry, d1: kind, d2: kind, e: int, n: int, tu: value, tv: value):
        weight = geo.weight[n // np_, n % np_]
        gu, gv = grad(geo.basis, e, n, d1[0], d2[0])
        ru = -gu
        rv = -gv
        if wp.static(advection):
            ru += tu
            rv -= tv
        r = fields()
        r[0] = weight * ru
        r[1] = weight * rv
        if wp.static(mass):
            r[2] = -weight * divergence(d1[1], d2[1])
        return r

    return kind, parts, rates


def surface_height(terms: Terms) -> Any:
    """Return the function (geometry, node, h) of h + b, or of h in a tangent or without bottom."""

    @func
    def surface(geo: geometry, node: index, h: value):
        if wp.static(terms.bottom and not terms.tangent):
            return h + load_nodes(geo.bottom, 0, node)
        else:
            return h

    return surface
