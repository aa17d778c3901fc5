"""The vector-invariant shallow-water equations at a point: transport, gradient, and all of them."""

from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.formulas import Formula, slopes, winds_at


def transport(t: SimpleNamespace, kind: str = "mass") -> Formula:
    """Divergence of a flux, written to one field of the result.

    "mass": -div(m V) of the mass m at `at` by the wind V of a, with the rounding of the depth in
    `shallow_water`.  "tangent": its derivative at the state a along x, both with winds in front.
    """
    np_, geometry, vector, load = t.np, t.geometry, t.vector, t.ops.load
    winds, wind = winds_at(t, own=False, base=False)
    point, rows, first, second = slopes(t, flux=True)
    flux = mass_flux(t, kind == "tangent")

    @no_type_check
    @wp.func
    def read(geo: geometry, w: winds, a: vector, x: vector, at: int, e: int, n: int):
        node = geo.nodes[e, n]
        m = load(x, at, node)
        bu = load(a, 0, node)
        bv = load(a, geo.size, node)
        if wp.static(kind == "mass"):
            fu, fv = flux(bu, bv, m, bu, bv, m)
            return point(fu, fv)
        else:
            u = load(x, 0, node)
            v = load(x, geo.size, node)
            fu, fv = flux(u, v, m, bu, bv, load(a, at, node))
            return point(fu, fv)

    @no_type_check
    @wp.func
    def result(geo: geometry, w: winds, d1: rows, d2: rows, e: int, n: int):
        return -geo.weight[n // np_, n % np_] * (d1 + d2)

    return Formula(winds, wind, rows, first, second, read, result, 1)


def gradient(t: SimpleNamespace) -> Formula:
    """grad s of the field at `at`, written to two fields of the result."""
    np_, geometry, vector, fields = t.np, t.geometry, t.vector, t.rows(2)
    load, wedge = t.ops.load, t.ops.wedge
    winds, wind = winds_at(t, own=False, base=False)
    point, rows, first, second = slopes(t, scalar=True)

    @no_type_check
    @wp.func
    def read(geo: geometry, w: winds, a: vector, x: vector, at: int, e: int, n: int):
        return point(load(x, at, geo.nodes[e, n]))

    @no_type_check
    @wp.func
    def result(geo: geometry, w: winds, d1: rows, d2: rows, e: int, n: int):
        weight = geo.weight[n // np_, n % np_]
        r = fields()
        r[0] = weight * wedge(d1, d2, geo.basis[e, n, 1], geo.basis[e, n, 3])
        r[1] = weight * wedge(geo.basis[e, n, 0], geo.basis[e, n, 2], d1, d2)
        return r

    return Formula(winds, wind, rows, first, second, read, result, 2)


def shallow_water(t: SimpleNamespace) -> Formula:
    """-zeta k x V - grad B and -div(h V), with B the Bernoulli function; or their exact tangent.

    The equations are quadratic, so the tangent at the state a along x is the same sum with each
    product replaced by its derivative.  In the skew form of `Terms.poisson`, wind and depth of the
    products zeta k x V and h V come from a, and B is given in the place of the depth.
    """
    np_, geometry, vector = t.np, t.geometry, t.vector
    mul, load, wedge = t.ops.mul, t.ops.load, t.ops.wedge
    terms, tangent, poisson = t.terms, t.terms.tangent, t.terms.poisson
    winds, wind = winds_at(t, own=True, base=tangent or poisson)
    mass, curls = not terms.momentum, terms.advection * (1 + tangent)
    point, rows, first, second = slopes(t, True, mass, curls)
    curl, alone, fields = 1 + mass, rows is t.value, t.rows(2 + mass)
    flux, head, surface = mass_flux(t, tangent), bernoulli(t), surface_height(t)

    @no_type_check
    @wp.func
    def read(geo: geometry, w: winds, a: vector, x: vector, at: int, e: int, n: int):
        node = geo.nodes[e, n]
        h = load(x, 2 * geo.size, node)
        p = point()
        if wp.static(poisson):
            hb = load(a, 2 * geo.size, node)
            fu, fv = flux(w.bu, w.bv, hb, w.bu, w.bv, hb)
            p.s = h
        elif wp.static(tangent):
            p.s = head(geo, w.bu, w.bv, w.u, w.v, h)
            if wp.static(mass):
                fu, fv = flux(w.u, w.v, h, w.bu, w.bv, load(a, 2 * geo.size, node))
        else:
            p.s = head(geo, w.u, w.v, w.u, w.v, surface(geo, node, h))
            if wp.static(mass):
                fu, fv = flux(w.u, w.v, h, w.u, w.v, h)
        if wp.static(mass):
            p.fu = fu
            p.fv = fv
        if wp.static(terms.advection):
            p.u = w.u
            p.v = w.v
            if wp.static(tangent):
                p.bu = w.bu
                p.bv = w.bv
        return p

    @no_type_check
    @wp.func
    def result(geo: geometry, w: winds, d1: rows, d2: rows, e: int, n: int):
        weight = geo.weight[n // np_, n % np_]
        if wp.static(alone):
            s1 = d1
            s2 = d2
        else:
            s1 = d1[0]
            s2 = d2[0]
        ru = -wedge(s1, s2, geo.basis[e, n, 1], geo.basis[e, n, 3])
        rv = -wedge(geo.basis[e, n, 0], geo.basis[e, n, 2], s1, s2)
        if wp.static(terms.advection):
            zeta = d1[curl] - d2[curl]
            if wp.static(tangent):
                zeta_base = d1[curl + 1] - d2[curl + 1]
                ru += mul(zeta_base, w.v) + mul(zeta, w.bv)
                rv -= mul(zeta_base, w.u) + mul(zeta, w.bu)
            elif wp.static(poisson):
                ru += mul(zeta, w.bv)
                rv -= mul(zeta, w.bu)
            else:
                ru += mul(zeta, w.v)
                rv -= mul(zeta, w.u)
        r = fields()
        r[0] = weight * ru
        r[1] = weight * rv
        if wp.static(mass):
            r[2] = -weight * (d1[1] + d2[1])
        return r

    stored = not (tangent or poisson)
    return Formula(winds, wind, rows, first, second, read, result, 2 + mass, True, stored)


def mass_flux(t: SimpleNamespace, tangent: bool) -> wp.Function:
    """Function (u, v, m, bu, bv, mb): the flux m V, or its derivative at (bu, bv, mb)."""
    mul, value = t.ops.mul, t.value

    @no_type_check
    @wp.func
    def flux(u: value, v: value, m: value, bu: value, bv: value, mb: value):
        if wp.static(tangent):
            return mul(mb, u) + mul(m, bu), mul(mb, v) + mul(m, bv)
        else:
            return mul(m, u), mul(m, v)

    return flux


def bernoulli(t: SimpleNamespace) -> wp.Function:
    """Function (geometry, bu, bv, u, v, h): |V|²/2 + g h, or its derivative at (bu, bv)."""
    terms, value, real, dot = t.terms, t.value, t.real, t.ops.dot

    @no_type_check
    @wp.func
    def head(geo: t.geometry, bu: value, bv: value, u: value, v: value, h: value):
        r = value(real(0.0))
        if wp.static(terms.advection and terms.tangent):
            r += dot(bu, bv, u, v)
        elif wp.static(terms.advection):
            r += real(0.5) * dot(u, v, u, v)
        if wp.static(terms.pressure):
            r += geo.gravity * h
        return r

    return head


def surface_height(t: SimpleNamespace) -> wp.Function:
    """Function (geometry, node, h): h + b, or h where there is no bottom or it does not change."""
    load = t.ops.load

    @no_type_check
    @wp.func
    def surface(geo: t.geometry, node: t.index, h: t.value):
        if wp.static(t.terms.bottom and not t.terms.tangent):
            return h + load(geo.bottom, 0, node)
        else:
            return h

    return surface
