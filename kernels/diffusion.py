"""Weak Laplacians at a point: of the wind (Hodge) and of the surface height."""

from dataclasses import dataclass
from typing import Any

import warp as wp

from swe_sphere.kernels.define import func
from swe_sphere.kernels.dynamics import surface_height
from swe_sphere.kernels.formulas import Formula, winds_at
from swe_sphere.kernels.terms import KernelTypes


@dataclass(frozen=True)
class Diffusion:
    """For each nodal test function, -(grad phi, grad s) of the surface height s, and for each
    nodal test wind -(div phi, div V) - (curl phi, curl V).
    """

    formula: Formula
    """Derivatives of the fields that diffuse; it has no result of its own."""
    fluxes: Any
    """(geometry, d1, d2, e, n): two rows, for the transposed derivatives along each line."""
    result: Any
    """(geometry, t1, t2, e, n, out): rows of the result, added to what other terms left in
    `out`."""


def diffusion(t: KernelTypes, height: bool, wind: bool) -> Diffusion:
    """Return the weak Laplacian of the surface height, of the wind or of both."""
    np_, metric, formula = t.np, t.metric, _diffused(t, height, wind)
    mul, flux, grad = metric.mul, metric.contravariant_flux, metric.gradient
    divergence, curl = metric.divergence, metric.curl
    rows, fields, at_div, at_curl = formula.rows, formula.fields, int(height), height + 1
    results, adds, first = (
        t.register.rows(fields), t.terms.dynamics, 0 if wind else t.terms.unknowns - 1
    )  # fmt: skip

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
        r = results()
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

    return Diffusion(formula, fluxes, result)


def _diffused(t: KernelTypes, height: bool, wind: bool) -> Formula:
    """Return the derivatives of the surface height and the wind, with their coefficients."""
    load, surface, value, real, metric = t.load, surface_height(t), t.value, t.real, t.metric
    flux, covariant = metric.contravariant_flux, metric.covariant_wind
    winds, no_wind = winds_at(t, own=False, base=False)
    rows, last, at_div, at_curl = (
        t.register.rows(height + 2 * wind), t.terms.unknowns - 1, int(height), height + 1
    )  # fmt: skip

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

    fields = height + 2 * wind
    return Formula(winds, no_wind, rows, slopes, None, fields, is_scalar=not wind)
