"""Weak Laplacians at a point: of the wind (Hodge) and of the surface height."""

from typing import Any

import warp as wp

from swe_sphere.kernels.define import func
from swe_sphere.kernels.dynamics import surface_height
from swe_sphere.kernels.formulas import Formula, winds_at
from swe_sphere.kernels.terms import KernelTypes


def diffusion(t: KernelTypes, height: bool, wind: bool) -> Formula:
    """Return the weak Laplacian of the surface height, of the wind or of both.

    It is -(grad phi, grad s) for each nodal test function and the surface height s, and
    -(div phi, div V) - (curl phi, curl V) for each nodal test wind.  `fluxes` returns the rows for
    the transposed derivatives, and `result` (geometry, t1, t2, e, n, out) adds their result to what
    other terms left in `out`.
    """
    np_, metric, fields = t.np, t.metric, height + 2 * wind
    mul, flux, grad = metric.mul, metric.contravariant_flux, metric.gradient
    divergence, curl = metric.divergence, metric.curl
    rows, at_div, at_curl = t.register.rows(fields), int(height), height + 1
    winds, no_wind = winds_at(t, own=False, base=False)
    adds, first = t.terms.dynamics, 0 if wind else t.terms.unknowns - 1

    @func
    def fluxes(geo: t.geometry, d1: rows, d2: rows, e: int, n: int):
        w = geo.weight[n // np_, n % np_] * geo.inverse_jacobian[e, n]
        f1 = rows()
        f2 = rows()
        if wp.static(height):
            u, v = grad(geo.basis, e, n, d1[0], d2[0])
            g1, g2 = flux(geo.basis, e, n, u, v)
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
    def result(geo: t.geometry, t1: rows, t2: rows, e: int, n: int, out: t.local):
        r = rows()
        if wp.static(height):
            r[fields - 1] = -divergence(t1[0], t2[0])
        if wp.static(wind):
            gu, gv = grad(geo.basis, e, n, t1[at_div], t2[at_div])
            cu, cv = grad(geo.basis, e, n, t1[at_curl], t2[at_curl])
            r[0] = cv - gu
            r[1] = -gv - cu
        if wp.static(adds):
            for k in range(fields):
                r[k] = r[k] + out[e, n, first + k]
        return r

    slopes = _diffused(t, height, wind, rows, winds)
    return Formula(winds, no_wind, rows, slopes, result, fields, not wind, fluxes=fluxes)


def _diffused(t: KernelTypes, height: bool, wind: bool, rows: Any, winds: Any) -> Any:
    """Return `Formula.slopes` of the surface height and the wind, with their coefficients."""
    load, surface, value, real, metric = t.load, surface_height(t), t.value, t.real, t.metric
    flux, covariant = metric.contravariant_flux, metric.covariant_wind
    last, at_div, at_curl = t.terms.unknowns - 1, int(height), height + 1

    @func
    def scaled(geo: t.geometry, offset: int, node: t.index, x: value):
        r = value(real(0.0))
        if wp.static(t.terms.diffusion):
            r += geo.nu * x
        if wp.static(t.terms.biharmonic):
            r -= geo.nu4 * load(geo.laplacian, offset, node)
        return r

    @func
    def slopes(geo: t.geometry, w: winds, a: t.vector, x: t.vector, at: int, e: int, n: int):
        node = geo.nodes[e, n]
        r1 = rows()
        r2 = rows()
        if wp.static(height):
            h = last * geo.size
            s = scaled(geo, h, node, surface(geo, node, load(x, h, node)))
            r1[0] = s
            r2[0] = s
        if wp.static(wind):
            u = scaled(geo, 0, node, load(x, 0, node))
            v = scaled(geo, geo.size, node, load(x, geo.size, node))
            f1, f2 = flux(geo.basis, e, n, u, v)
            u1, u2 = covariant(geo.basis, e, n, u, v)
            r1[at_div] = f1
            r1[at_curl] = u2
            r2[at_div] = f2
            r2[at_curl] = u1
        return r1, r2

    return slopes
