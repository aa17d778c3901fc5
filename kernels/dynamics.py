"""The vector-invariant shallow-water equations at a point, and their parts.

The equations are quadratic, so the tangent at a state along a direction is the same sum with each
product replaced by its derivative.
"""

from typing import Any

import warp as wp

from swe_sphere.kernels.define import func
from swe_sphere.kernels.formulas import Formula, winds_at
from swe_sphere.kernels.terms import KernelTypes


def transport(t: KernelTypes, tangent: bool = False) -> Formula:
    """Return the formula of -div(m V): mass m at `at`, wind V of a; rounded as in `state`.

    The tangent is -div(m' V + m V'), with (V, m) of the state a and (V', m') of x.
    """
    load, mul, flux, row = t.load, t.metric.mul, t.metric.contravariant_flux, one_row(t)
    winds, wind = winds_at(t, own=tangent, base=True)
    np_, rows, divergence = t.np, t.register.rows(1), t.metric.divergence

    @func
    def slopes(geo: t.geometry, w: winds, a: t.vector, x: t.vector, at: int, e: int, n: int):
        node = geo.nodes[e, n]
        m = load(x, at, node)
        if wp.static(tangent):
            mb = load(a, at, node)
            fu = mul(mb, w[0]) + mul(m, w[2])
            fv = mul(mb, w[1]) + mul(m, w[3])
            f1, f2 = flux(geo.basis, e, n, fu, fv)
            return row(f1), row(f2)
        else:
            f1, f2 = flux(geo.basis, e, n, mul(m, w[0]), mul(m, w[1]))
            return row(f1), row(f2)

    @func
    def result(geo: t.geometry, w: winds, d1: rows, d2: rows, e: int, n: int):
        return row(-geo.weight[n // np_, n % np_] * divergence(d1[0], d2[0]))

    return Formula(winds, wind, rows, slopes, result, 1)


def gradient(t: KernelTypes) -> Formula:
    """Return the formula of grad s, for the field s at `at`."""
    np_, load, grad, row = t.np, t.load, t.metric.gradient, one_row(t)
    winds, wind = winds_at(t, own=False, base=False)
    rows, fields = t.register.rows(1), t.register.rows(2)

    @func
    def slopes(geo: t.geometry, w: winds, a: t.vector, x: t.vector, at: int, e: int, n: int):
        s = row(load(x, at, geo.nodes[e, n]))
        return s, s

    @func
    def result(geo: t.geometry, w: winds, d1: rows, d2: rows, e: int, n: int):
        weight = geo.weight[n // np_, n % np_]
        east, north = grad(geo.basis, e, n, d1[0], d2[0])
        r = fields()
        r[0] = weight * east
        r[1] = weight * north
        return r

    return Formula(winds, wind, rows, slopes, result, 2, is_scalar=True)


def state(t: KernelTypes) -> Formula:
    """Return the formula of -zeta k x V - grad B and -div(h V), with B = |V|²/2 + g (h + b)."""
    real, value, terms, load = t.real, t.value, t.terms, t.load
    mul, dot, curl = t.metric.mul, t.metric.dot, t.metric.curl
    winds, wind = winds_at(t, own=True, base=False)
    rows, parts, rates = _equations(t, curls=1)
    bernoulli, surface, last = bernoulli_of(t), surface_height(t), 2 - terms.momentum

    @func
    def slopes(geo: t.geometry, w: winds, a: t.vector, x: t.vector, at: int, e: int, n: int):
        node = geo.nodes[e, n]
        h = load(x, 2 * geo.size, node)
        kinetic = value(real(0.0))
        if wp.static(terms.advection):
            kinetic = real(0.5) * dot(w[0], w[1], w[0], w[1])
        head = bernoulli(geo, kinetic, surface(geo, node, h))
        return parts(geo, e, n, head, mul(h, w[0]), mul(h, w[1]), w[0], w[1])

    @func
    def result(geo: t.geometry, w: winds, d1: rows, d2: rows, e: int, n: int):
        if wp.static(terms.advection):
            zeta = curl(d1[last], d2[last])
            return rates(geo, d1, d2, e, n, mul(zeta, w[1]), mul(zeta, w[0]))
        else:
            return rates(geo, d1, d2, e, n, value(real(0.0)), value(real(0.0)))

    return Formula(winds, wind, rows, slopes, result, 3 - terms.momentum, turns=True)


def tangent(t: KernelTypes) -> Formula:
    """Return the formula of the derivative of `state` at the state a along x."""
    real, value, terms, load = t.real, t.value, t.terms, t.load
    mul, dot, curl, covariant = t.metric.mul, t.metric.dot, t.metric.curl, t.metric.covariant_wind
    winds, wind = winds_at(t, own=True, base=True)
    rows, parts, rates = _equations(t, curls=2)
    bernoulli, last = bernoulli_of(t), 2 - terms.momentum

    @func
    def slopes(geo: t.geometry, w: winds, a: t.vector, x: t.vector, at: int, e: int, n: int):
        node = geo.nodes[e, n]
        h = load(x, 2 * geo.size, node)
        hb = load(a, 2 * geo.size, node)
        kinetic = value(real(0.0))
        if wp.static(terms.advection):
            kinetic = dot(w[2], w[3], w[0], w[1])
        head = bernoulli(geo, kinetic, h)
        fu = mul(hb, w[0]) + mul(h, w[2])
        fv = mul(hb, w[1]) + mul(h, w[3])
        r1, r2 = parts(geo, e, n, head, fu, fv, w[0], w[1])
        if wp.static(terms.advection):
            u1, u2 = covariant(geo.basis, e, n, w[2], w[3])
            r1[last + 1] = u2
            r2[last + 1] = u1
        return r1, r2

    @func
    def result(geo: t.geometry, w: winds, d1: rows, d2: rows, e: int, n: int):
        if wp.static(terms.advection):
            zeta = curl(d1[last], d2[last])
            zeta_base = curl(d1[last + 1], d2[last + 1])
            tu = mul(zeta_base, w[1]) + mul(zeta, w[3])
            tv = mul(zeta_base, w[0]) + mul(zeta, w[2])
            return rates(geo, d1, d2, e, n, tu, tv)
        else:
            return rates(geo, d1, d2, e, n, value(real(0.0)), value(real(0.0)))

    return Formula(winds, wind, rows, slopes, result, 3 - terms.momentum, turns=True)


def skew(t: KernelTypes) -> Formula:
    """Return the formula of -zeta k x Vb - grad B and -div(hb Vb).

    zeta is the vorticity of the wind of x and B the field in the place of its depth; Vb and hb are
    wind and depth of the state a.  See `Terms.poisson`.
    """
    load, mul, curl = t.load, t.metric.mul, t.metric.curl
    winds, wind = winds_at(t, own=True, base=True)
    rows, parts, rates = _equations(t, curls=1)

    @func
    def slopes(geo: t.geometry, w: winds, a: t.vector, x: t.vector, at: int, e: int, n: int):
        node = geo.nodes[e, n]
        head = load(x, 2 * geo.size, node)
        h = load(a, 2 * geo.size, node)
        return parts(geo, e, n, head, mul(h, w[2]), mul(h, w[3]), w[0], w[1])

    @func
    def result(geo: t.geometry, w: winds, d1: rows, d2: rows, e: int, n: int):
        zeta = curl(d1[2], d2[2])
        return rates(geo, d1, d2, e, n, mul(zeta, w[3]), mul(zeta, w[2]))

    return Formula(winds, wind, rows, slopes, result, 3, turns=True)


def _equations(t: KernelTypes, curls: int) -> tuple[Any, Any, Any]:
    """Return the rows of the momentum and continuity equations, how they begin and what they give.

    The rows are B, the flux of the continuity equation, and `curls` winds where there is advection.
    `parts` (geometry, e, n, head, fu, fv, u, v) makes the rows, but for a second wind; `rates`
    (geometry, d1, d2, e, n, tu, tv) the rates of the wind, turned by (tu, -tv), and of the depth.
    """
    np_, value, mass, advection = t.np, t.value, not t.terms.momentum, t.terms.advection
    rows, fields = t.register.rows(1 + mass + advection * curls), t.register.rows(2 + mass)
    flux, covariant = t.metric.contravariant_flux, t.metric.covariant_wind
    grad, divergence, last = t.metric.gradient, t.metric.divergence, 1 + mass

    @func
    def parts(
        geo: t.geometry, e: int, n: int, head: value, fu: value, fv: value, u: value, v: value
    ):
        r1 = rows()
        r2 = rows()
        r1[0] = head
        r2[0] = head
        if wp.static(mass):
            f1, f2 = flux(geo.basis, e, n, fu, fv)
            r1[1] = f1
            r2[1] = f2
        if wp.static(advection):
            u1, u2 = covariant(geo.basis, e, n, u, v)
            r1[last] = u2
            r2[last] = u1
        return r1, r2

    @func
    def rates(geo: t.geometry, d1: rows, d2: rows, e: int, n: int, tu: value, tv: value):
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

    return rows, parts, rates


def bernoulli_of(t: KernelTypes) -> Any:
    """Return the function (geometry, kinetic, h): kinetic energy + g h, with a pressure term."""
    terms = t.terms

    @func
    def bernoulli(geo: t.geometry, kinetic: t.value, h: t.value):
        r = kinetic
        if wp.static(terms.pressure):
            r += geo.gravity * h
        return r

    return bernoulli


def surface_height(t: KernelTypes) -> Any:
    """Return the function (geometry, node, h): h + b, or h without a bottom or in a tangent."""
    load = t.load

    @func
    def surface(geo: t.geometry, node: t.index, h: t.value):
        if wp.static(t.terms.bottom and not t.terms.tangent):
            return h + load(geo.bottom, 0, node)
        else:
            return h

    return surface


def one_row(t: KernelTypes) -> Any:
    """Return the function (v): the rows that hold the register v alone."""
    rows = t.register.rows(1)

    @func
    def row(v: t.value):
        r = rows()
        r[0] = v
        return r

    return row
