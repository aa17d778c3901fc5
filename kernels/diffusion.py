"""Weak Laplacians at a point: of the wind (Hodge) and of the surface height."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.dynamics import surface_height
from swe_sphere.kernels.formulas import Formula, slopes, winds_at


@dataclass(frozen=True)
class Diffusion:
    """For each nodal test function, -(grad phi, grad s) of the surface height s, and for each
    nodal test wind -(div phi, div V) - (curl phi, curl V).
    """

    formula: Formula
    """Of the fields that diffuse, without a result of its own."""
    fluxes: wp.Function
    """(geometry, d1, d2, e, n): two rows, for the transposed derivatives along each line."""
    result: wp.Function
    """(geometry, t1, t2, e, n, out): what is made of those, a value or rows, added to what `out`
    has from other terms."""


def diffusion(t: SimpleNamespace, height: bool, wind: bool) -> Diffusion:
    """The weak Laplacian of the surface height, of the wind or of both."""
    np_, real, last, adds = t.np, t.real, t.terms.unknowns - 1, t.terms.dynamics
    wedge, mul, value = t.ops.wedge, t.ops.mul, t.value
    formula = _diffused(t, height, wind)
    rows, at_div, at_curl = formula.rows, int(height), height + 1
    results = t.rows(formula.fields)

    @no_type_check
    @wp.func
    def raised(geo: t.geometry, w: value, d1: value, d2: value, e: int, n: int):
        u = wedge(d1, d2, geo.basis[e, n, 1], geo.basis[e, n, 3])
        v = wedge(geo.basis[e, n, 0], geo.basis[e, n, 2], d1, d2)
        f1 = mul(w, wedge(u, v, geo.basis[e, n, 2], geo.basis[e, n, 3]))
        f2 = mul(w, wedge(geo.basis[e, n, 0], geo.basis[e, n, 1], u, v))
        return f1, f2

    @no_type_check
    @wp.func
    def fluxes(geo: t.geometry, d1: rows, d2: rows, e: int, n: int):
        w = geo.weight[n // np_, n % np_] * geo.inverse_jacobian[e, n]
        f1 = rows(real(0.0))
        f2 = rows(real(0.0))
        if wp.static(height and wind):
            g1, g2 = raised(geo, w, d1[0], d2[0], e, n)
            f1[0] = g1
            f2[0] = g2
        elif wp.static(height):
            f1, f2 = raised(geo, w, d1, d2, e, n)
        if wp.static(wind):
            div = mul(w, d1[at_div] + d2[at_div])
            curl = mul(w, d1[at_curl] - d2[at_curl])
            f1[at_div] = div
            f1[at_curl] = curl
            f2[at_div] = div
            f2[at_curl] = curl
        return f1, f2

    @no_type_check
    @wp.func
    def result(geo: t.geometry, t1: rows, t2: rows, e: int, n: int, out: t.local):
        if wp.static(not wind):
            r = -t1 - t2
            if wp.static(adds):
                r += out[e, n, last]
            return r
        else:
            a11 = geo.basis[e, n, 0]
            a12 = geo.basis[e, n, 1]
            a21 = geo.basis[e, n, 2]
            a22 = geo.basis[e, n, 3]
            ru = -wedge(t1[at_div], t2[at_div], a12, a22)
            rv = -wedge(a11, a21, t1[at_div], t2[at_div])
            ru -= wedge(t1[at_curl], t2[at_curl], a11, a21)
            rv -= wedge(t1[at_curl], t2[at_curl], a12, a22)
            r = results()
            r[0] = ru
            r[1] = rv
            if wp.static(height):
                r[2] = -t1[0] - t2[0]
            if wp.static(adds):
                for k in range(wp.static(formula.fields)):
                    r[k] = r[k] + out[e, n, k]
            return r

    return Diffusion(formula, fluxes, result)


def _diffused(t: SimpleNamespace, height: bool, wind: bool) -> Formula:
    """The surface height and the wind, with their coefficients."""
    load, surface, value, real = t.ops.load, surface_height(t), t.value, t.real
    winds, no_wind = winds_at(t, own=False, base=False)
    point, rows, first, second = slopes(t, scalar=height, flux=wind, curls=int(wind))
    last = t.terms.unknowns - 1

    @no_type_check
    @wp.func
    def scaled(geo: t.geometry, offset: int, node: t.index, x: t.value):
        r = value(real(0.0))
        if wp.static(t.terms.diffusion):
            r += geo.nu * x
        if wp.static(t.terms.biharmonic):
            r -= geo.nu4 * load(geo.laplacian, offset, node)
        return r

    @no_type_check
    @wp.func
    def read(geo: t.geometry, w: winds, a: t.vector, x: t.vector, at: int, e: int, n: int):
        node = geo.nodes[e, n]
        p = point()
        if wp.static(height):
            h = last * geo.size
            p.s = scaled(geo, h, node, surface(geo, node, load(x, h, node)))
        if wp.static(wind):
            u = scaled(geo, 0, node, load(x, 0, node))
            v = scaled(geo, geo.size, node, load(x, geo.size, node))
            p.fu = u
            p.fv = v
            p.u = u
            p.v = v
        return p

    return Formula(winds, no_wind, rows, first, second, read, fields=height + 2 * wind)
