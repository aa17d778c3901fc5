"""One thread an element node: the launch shape for GPUs.

Each thread sums along the two lines of nodes through its own node.  Neighbouring threads read the
same lines, so the repeated loads come from the cache.  A weak Laplacian needs two nested line sums:
a first kernel writes the fluxes of every node, the tendency kernel takes their weak divergence.
"""

from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.formulas import algebra, physics
from swe_sphere.kernels.terms import Terms, geometry_struct


def node_kernel(terms: Terms, np_: int, real: type) -> SimpleNamespace:
    """Kernels for the mass-weighted tendencies of each element node, before DSS.

    The same formulas, arguments and results as `element_kernel` with one lane: `kernel` is launched
    over (E, np*np) threads with (geometry, state, out of shape (E, np*np, unknowns)).  With
    diffusion, `flux_kernel` (geometry, state) goes before it over the same threads and fills
    `geometry.fluxes` of shape (E, np*np, 4): two contravariant height fluxes, w div V, w curl V.
    """
    geometry = geometry_struct(terms, real, wp.int32, real, fluxes=True)
    t = SimpleNamespace(
        terms=terms,
        np=np_,
        real=real,
        geometry=geometry,
        vector=wp.array(dtype=real),
        local=wp.array3d(dtype=real),
    )
    ops = algebra(real, wp.int32, real, 1)
    laws = physics(terms, geometry, real, wp.int32, real, ops)
    dynamics = (_transport if terms.wind else _shallow_water)(t, ops, laws)
    diffusion = _weak_divergence(t, ops)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options={"max_unroll": 1})
    def tendency(geo: geometry, x: t.vector, out: t.local):
        e, n = wp.tid()
        if wp.static(terms.dynamics):
            dynamics(geo, x, e, n, out)
        if wp.static(terms.diffuses):
            diffusion(geo, e, n, out)

    flux = _flux_kernel(t, ops, laws) if terms.diffuses else None
    return SimpleNamespace(
        kernel=tendency, flux_kernel=flux, geometry=geometry, value=real, index=wp.int32, lanes=1
    )


def _transport(t: SimpleNamespace, ops: SimpleNamespace, laws: SimpleNamespace) -> wp.Function:
    """-div(h V) of depth alone, carried by the prescribed wind; linear, so its own tangent."""
    np_, real, wedge = t.np, t.real, ops.wedge

    @no_type_check
    @wp.func
    def transport(geo: t.geometry, x: t.vector, e: int, n: int, out: t.local):
        i = n // np_
        j = n % np_
        div = real(0.0)
        for m in range(np_):
            p = m * np_ + j
            node = geo.nodes[e, p]
            flux = wedge(
                geo.wind[node], geo.wind[geo.size + node], geo.basis[e, p, 2], geo.basis[e, p, 3]
            )
            div += geo.derivative[i, m] * x[node] * flux
            p = i * np_ + m
            node = geo.nodes[e, p]
            flux = wedge(
                geo.basis[e, p, 0], geo.basis[e, p, 1], geo.wind[node], geo.wind[geo.size + node]
            )
            div += geo.derivative[j, m] * x[node] * flux
        out[e, n, 0] = -geo.weight[i, j] * div

    return transport


def _shallow_water(t: SimpleNamespace, ops: SimpleNamespace, laws: SimpleNamespace) -> wp.Function:
    """-zeta k x V - grad B and -div(h V), with B the Bernoulli function; or their exact tangent.

    Or, with `Terms.poisson`, the skew form: wind and depth of the products from `base`, B given.
    """
    np_, real = t.np, t.real
    advection, tangent, poisson = t.terms.advection, t.terms.tangent, t.terms.poisson
    dot, wedge = ops.dot, ops.wedge

    @no_type_check
    @wp.func
    def bernoulli(geo: t.geometry, x: t.vector, node: int):
        u = x[node]
        v = x[geo.size + node]
        h = x[2 * geo.size + node]
        if wp.static(poisson):
            return h
        elif wp.static(tangent):
            return laws.bernoulli_tangent(geo, geo.base[node], geo.base[geo.size + node], u, v, h)
        else:
            return laws.bernoulli(geo, u, v, laws.surface(geo, node, h))

    @no_type_check
    @wp.func
    def momentum(geo: t.geometry, x: t.vector, node: int, component: int):
        a = component * geo.size + node
        h = 2 * geo.size + node
        if wp.static(poisson):
            return geo.base[h] * geo.base[a]
        elif wp.static(tangent):
            return geo.base[h] * x[a] + x[h] * geo.base[a]
        else:
            return x[h] * x[a]

    @no_type_check
    @wp.func
    def shallow_water(geo: t.geometry, x: t.vector, e: int, n: int, out: t.local):
        i = n // np_
        j = n % np_
        b1 = real(0.0)
        b2 = real(0.0)
        div = real(0.0)
        zeta = real(0.0)
        zeta_base = real(0.0)
        for m in range(np_):
            d = geo.derivative[i, m]
            p = m * np_ + j
            node = geo.nodes[e, p]
            a1 = geo.basis[e, p, 2]
            a2 = geo.basis[e, p, 3]
            b1 += d * bernoulli(geo, x, node)
            div += d * wedge(momentum(geo, x, node, 0), momentum(geo, x, node, 1), a1, a2)
            if wp.static(advection):
                zeta += d * dot(a1, a2, x[node], x[geo.size + node])
                if wp.static(tangent):
                    zeta_base += d * dot(a1, a2, geo.base[node], geo.base[geo.size + node])
            d = geo.derivative[j, m]
            p = i * np_ + m
            node = geo.nodes[e, p]
            a1 = geo.basis[e, p, 0]
            a2 = geo.basis[e, p, 1]
            b2 += d * bernoulli(geo, x, node)
            div += d * wedge(a1, a2, momentum(geo, x, node, 0), momentum(geo, x, node, 1))
            if wp.static(advection):
                zeta -= d * dot(a1, a2, x[node], x[geo.size + node])
                if wp.static(tangent):
                    zeta_base -= d * dot(a1, a2, geo.base[node], geo.base[geo.size + node])
        ru = -wedge(b1, b2, geo.basis[e, n, 1], geo.basis[e, n, 3])
        rv = -wedge(geo.basis[e, n, 0], geo.basis[e, n, 2], b1, b2)
        if wp.static(advection):
            node = geo.nodes[e, n]
            if wp.static(tangent):
                ru += zeta_base * x[geo.size + node] + zeta * geo.base[geo.size + node]
                rv -= zeta_base * x[node] + zeta * geo.base[node]
            elif wp.static(poisson):
                ru += zeta * geo.base[geo.size + node]
                rv -= zeta * geo.base[node]
            else:
                ru += zeta * x[geo.size + node]
                rv -= zeta * x[node]
        out[e, n, 0] = geo.weight[i, j] * ru
        out[e, n, 1] = geo.weight[i, j] * rv
        out[e, n, 2] = -geo.weight[i, j] * div

    return shallow_water


def _flux_kernel(t: SimpleNamespace, ops: SimpleNamespace, laws: SimpleNamespace) -> wp.Kernel:
    """Fluxes of the diffused fields at each element node, times quadrature weights."""
    np_, real, last = t.np, t.real, t.terms.unknowns - 1
    dot, wedge = ops.dot, ops.wedge

    @no_type_check
    @wp.func
    def height(geo: t.geometry, x: t.vector, node: int):
        at = last * geo.size
        return laws.diffused(geo, at, node, laws.surface(geo, node, x[at + node]))

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options={"max_unroll": 1})
    def flux(geo: t.geometry, x: t.vector):
        e, n = wp.tid()
        i = n // np_
        j = n % np_
        s1 = real(0.0)
        s2 = real(0.0)
        div = real(0.0)
        curl = real(0.0)
        for m in range(np_):
            d = geo.derivative[i, m]
            p = m * np_ + j
            node = geo.nodes[e, p]
            s1 += d * height(geo, x, node)
            if wp.static(last == 2):
                u = laws.diffused(geo, 0, node, x[node])
                v = laws.diffused(geo, geo.size, node, x[geo.size + node])
                div += d * wedge(u, v, geo.basis[e, p, 2], geo.basis[e, p, 3])
                curl += d * dot(geo.basis[e, p, 2], geo.basis[e, p, 3], u, v)
            d = geo.derivative[j, m]
            p = i * np_ + m
            node = geo.nodes[e, p]
            s2 += d * height(geo, x, node)
            if wp.static(last == 2):
                u = laws.diffused(geo, 0, node, x[node])
                v = laws.diffused(geo, geo.size, node, x[geo.size + node])
                div += d * wedge(geo.basis[e, p, 0], geo.basis[e, p, 1], u, v)
                curl -= d * dot(geo.basis[e, p, 0], geo.basis[e, p, 1], u, v)
        w = geo.weight[i, j] * geo.inverse_jacobian[e, n]
        su = wedge(s1, s2, geo.basis[e, n, 1], geo.basis[e, n, 3])
        sv = wedge(geo.basis[e, n, 0], geo.basis[e, n, 2], s1, s2)
        geo.fluxes[e, n, 0] = w * wedge(su, sv, geo.basis[e, n, 2], geo.basis[e, n, 3])
        geo.fluxes[e, n, 1] = w * wedge(geo.basis[e, n, 0], geo.basis[e, n, 1], su, sv)
        if wp.static(last == 2):
            geo.fluxes[e, n, 2] = w * div
            geo.fluxes[e, n, 3] = w * curl

    return flux


def _weak_divergence(t: SimpleNamespace, ops: SimpleNamespace) -> wp.Function:
    """Adds the weak Laplacians from the fluxes that `_flux_kernel` left."""
    np_, real, adds, last = t.np, t.real, t.terms.dynamics, t.terms.unknowns - 1
    wedge = ops.wedge

    @no_type_check
    @wp.func
    def weak_divergence(geo: t.geometry, e: int, n: int, out: t.local):
        i = n // np_
        j = n % np_
        r = real(0.0)
        p1 = real(0.0)
        p2 = real(0.0)
        q1 = real(0.0)
        q2 = real(0.0)
        for m in range(np_):
            d1 = geo.derivative[m, i]
            d2 = geo.derivative[m, j]
            p = m * np_ + j
            q = i * np_ + m
            r -= d1 * geo.fluxes[e, p, 0] + d2 * geo.fluxes[e, q, 1]
            if wp.static(last == 2):
                p1 += d1 * geo.fluxes[e, p, 2]
                p2 += d2 * geo.fluxes[e, q, 2]
                q1 += d1 * geo.fluxes[e, p, 3]
                q2 += d2 * geo.fluxes[e, q, 3]
        if wp.static(adds):
            r += out[e, n, last]
        out[e, n, last] = r
        if wp.static(last == 2):
            a11 = geo.basis[e, n, 0]
            a12 = geo.basis[e, n, 1]
            a21 = geo.basis[e, n, 2]
            a22 = geo.basis[e, n, 3]
            ru = -wedge(p1, p2, a12, a22) - wedge(q1, q2, a11, a21)
            rv = -wedge(a11, a21, p1, p2) - wedge(q1, q2, a12, a22)
            if wp.static(adds):
                ru += out[e, n, 0]
                rv += out[e, n, 1]
            out[e, n, 0] = ru
            out[e, n, 1] = rv

    return weak_divergence
