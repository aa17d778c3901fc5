"""One thread a group of elements: the launch shape for CPUs.

Each SIMD lane holds one element, so that every product of the tensor derivative is one instruction
for `lanes` elements; the work arrays of a group stay in the first-level cache.
"""

from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.formulas import algebra, physics
from swe_sphere.kernels.terms import Terms, geometry_struct, lanes_of


def element_kernel(terms: Terms, np_: int, real: type) -> SimpleNamespace:
    """Kernel for the mass-weighted tendencies of each element, before DSS.

    `np_` GLL nodes an edge, `real` the number type.  Returns a namespace with `kernel`, launched
    with (geometry, state of shape (unknowns*N,), out of shape (groups, np*np, unknowns) of SIMD
    registers) over one thread a group, and the types `geometry`, `value`, `index`, and `lanes`.
    """
    lanes = lanes_of(real)
    value, index = wp.types.vector(lanes, real), wp.types.vector(lanes, wp.int32)
    geometry = geometry_struct(terms, value, index, real)
    types = SimpleNamespace(
        terms=terms,
        np=np_,
        real=real,
        value=value,
        geometry=geometry,
        vector=wp.array(dtype=real),
        local=wp.array3d(dtype=value),
    )
    ops = algebra(value, index, real, lanes)
    laws = physics(terms, geometry, value, index, real, ops)
    line = line_sums(np_, value, real)
    dynamics = (_transport if terms.wind else _shallow_water)(types, ops, laws, line)
    diffuse_wind = _diffusion_of_wind(types, ops, laws, line)
    diffuse_height = _diffusion_of_height(types, ops, laws, line)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options={"max_unroll": 1})
    def tendency(geo: geometry, x: types.vector, out: types.local):
        e = wp.tid()
        if wp.static(terms.dynamics):
            dynamics(geo, x, e, out)
        if wp.static(terms.diffuses):
            diffuse_height(geo, x, e, out)
            if wp.static(not terms.wind):
                diffuse_wind(geo, x, e, out)

    return SimpleNamespace(
        kernel=tendency, geometry=geometry, value=value, index=index, lanes=lanes
    )


def line_sums(np_: int, value: type, real: type) -> SimpleNamespace:
    """Derivative of an element's field along each coordinate (d1, d2), and transposes (t1, t2)."""
    matrix, field = wp.array2d(dtype=real), wp.array2d(dtype=value)

    @no_type_check
    @wp.func
    def d1(d: matrix, f: field, i: int, j: int):
        r = value()
        for m in range(np_):
            r += d[i, m] * f[m, j]
        return r

    @no_type_check
    @wp.func
    def d2(d: matrix, f: field, i: int, j: int):
        r = value()
        for m in range(np_):
            r += d[j, m] * f[i, m]
        return r

    @no_type_check
    @wp.func
    def t1(d: matrix, f: field, i: int, j: int):
        r = value()
        for m in range(np_):
            r += d[m, i] * f[m, j]
        return r

    @no_type_check
    @wp.func
    def t2(d: matrix, f: field, i: int, j: int):
        r = value()
        for m in range(np_):
            r += d[m, j] * f[i, m]
        return r

    return SimpleNamespace(d1=d1, d2=d2, t1=t1, t2=t2)


def _transport(
    t: SimpleNamespace, ops: SimpleNamespace, laws: SimpleNamespace, line: SimpleNamespace
) -> wp.Function:
    """-div(h V) of depth alone, carried by the prescribed wind; linear, so its own tangent."""
    np_, value = t.np, t.value
    mul, load, wedge, d1, d2 = ops.mul, ops.load, ops.wedge, line.d1, line.d2

    @no_type_check
    @wp.func
    def transport(geo: t.geometry, x: t.vector, e: int, out: t.local):
        f1 = wp.zeros(shape=(np_, np_), dtype=value)
        f2 = wp.zeros(shape=(np_, np_), dtype=value)
        for i in range(np_):
            for j in range(np_):
                n = i * np_ + j
                node = geo.nodes[e, n]
                u = load(geo.wind, 0, node)
                v = load(geo.wind, geo.size, node)
                h = load(x, 0, node)
                f1[i, j] = mul(h, wedge(u, v, geo.basis[e, n, 2], geo.basis[e, n, 3]))
                f2[i, j] = mul(h, wedge(geo.basis[e, n, 0], geo.basis[e, n, 1], u, v))
        for i in range(np_):
            for j in range(np_):
                div = d1(geo.derivative, f1, i, j) + d2(geo.derivative, f2, i, j)
                out[e, i * np_ + j, 0] = -geo.weight[i, j] * div

    return transport


def _shallow_water(
    t: SimpleNamespace, ops: SimpleNamespace, laws: SimpleNamespace, line: SimpleNamespace
) -> wp.Function:
    """-zeta k x V - grad B and -div(h V), with B the Bernoulli function; or their exact tangent.

    The equations are quadratic, so the tangent at `base` along x is the same sum with each product
    replaced by its derivative.  In the skew form of `Terms.poisson`, wind and depth of the products
    zeta k x V and h V come from `base`, and B is given.
    """
    np_, value = t.np, t.value
    advection, tangent, poisson = t.terms.advection, t.terms.tangent, t.terms.poisson
    mul, load, dot, wedge, d1, d2 = ops.mul, ops.load, ops.dot, ops.wedge, line.d1, line.d2

    @no_type_check
    @wp.func
    def shallow_water(geo: t.geometry, x: t.vector, e: int, out: t.local):
        b = wp.zeros(shape=(np_, np_), dtype=value)
        f1 = wp.zeros(shape=(np_, np_), dtype=value)
        f2 = wp.zeros(shape=(np_, np_), dtype=value)
        if wp.static(advection):
            c1 = wp.zeros(shape=(np_, np_), dtype=value)
            c2 = wp.zeros(shape=(np_, np_), dtype=value)
            us = wp.zeros(shape=(np_, np_), dtype=value)
            vs = wp.zeros(shape=(np_, np_), dtype=value)
            if wp.static(tangent):
                base_us = wp.zeros(shape=(np_, np_), dtype=value)
                base_vs = wp.zeros(shape=(np_, np_), dtype=value)
                base1 = wp.zeros(shape=(np_, np_), dtype=value)
                base2 = wp.zeros(shape=(np_, np_), dtype=value)
        for i in range(np_):
            for j in range(np_):
                n = i * np_ + j
                node = geo.nodes[e, n]
                a11 = geo.basis[e, n, 0]
                a12 = geo.basis[e, n, 1]
                a21 = geo.basis[e, n, 2]
                a22 = geo.basis[e, n, 3]
                u = load(x, 0, node)
                v = load(x, geo.size, node)
                h = load(x, 2 * geo.size, node)
                if wp.static(poisson):
                    b[i, j] = h
                    h = load(geo.base, 2 * geo.size, node)
                    ub = load(geo.base, 0, node)
                    vb = load(geo.base, geo.size, node)
                    mass_u = mul(h, ub)
                    mass_v = mul(h, vb)
                elif wp.static(tangent):
                    ub = load(geo.base, 0, node)
                    vb = load(geo.base, geo.size, node)
                    hb = load(geo.base, 2 * geo.size, node)
                    b[i, j] = laws.bernoulli_tangent(geo, ub, vb, u, v, h)
                    mass_u = mul(hb, u) + mul(h, ub)
                    mass_v = mul(hb, v) + mul(h, vb)
                else:
                    b[i, j] = laws.bernoulli(geo, u, v, laws.surface(geo, node, h))
                    mass_u = mul(h, u)
                    mass_v = mul(h, v)
                f1[i, j] = wedge(mass_u, mass_v, a21, a22)
                f2[i, j] = wedge(a11, a12, mass_u, mass_v)
                if wp.static(advection):
                    c1[i, j] = dot(a11, a12, u, v)
                    c2[i, j] = dot(a21, a22, u, v)
                    if wp.static(poisson):
                        us[i, j] = ub
                        vs[i, j] = vb
                    else:
                        us[i, j] = u
                        vs[i, j] = v
                    if wp.static(tangent):
                        base_us[i, j] = ub
                        base_vs[i, j] = vb
                        base1[i, j] = dot(a11, a12, ub, vb)
                        base2[i, j] = dot(a21, a22, ub, vb)
        for i in range(np_):
            for j in range(np_):
                n = i * np_ + j
                d = geo.derivative
                b1 = d1(d, b, i, j)
                b2 = d2(d, b, i, j)
                ru = -wedge(b1, b2, geo.basis[e, n, 1], geo.basis[e, n, 3])
                rv = -wedge(geo.basis[e, n, 0], geo.basis[e, n, 2], b1, b2)
                if wp.static(advection):
                    zeta = d1(d, c2, i, j) - d2(d, c1, i, j)
                    if wp.static(tangent):
                        zeta_base = d1(d, base2, i, j) - d2(d, base1, i, j)
                        ru += mul(zeta_base, vs[i, j]) + mul(zeta, base_vs[i, j])
                        rv -= mul(zeta_base, us[i, j]) + mul(zeta, base_us[i, j])
                    else:
                        ru += mul(zeta, vs[i, j])
                        rv -= mul(zeta, us[i, j])
                out[e, n, 0] = geo.weight[i, j] * ru
                out[e, n, 1] = geo.weight[i, j] * rv
                out[e, n, 2] = -geo.weight[i, j] * (d1(d, f1, i, j) + d2(d, f2, i, j))

    return shallow_water


def _diffusion_of_wind(
    t: SimpleNamespace, ops: SimpleNamespace, laws: SimpleNamespace, line: SimpleNamespace
) -> wp.Function:
    """Weak Hodge Laplacian, -(div phi, div V) - (curl phi, curl V) for each nodal test wind phi."""
    np_, value, adds = t.np, t.value, t.terms.dynamics
    mul, load, dot, wedge = ops.mul, ops.load, ops.dot, ops.wedge
    d1, d2, t1, t2 = line.d1, line.d2, line.t1, line.t2

    @no_type_check
    @wp.func
    def diffusion(geo: t.geometry, x: t.vector, e: int, out: t.local):
        c1 = wp.zeros(shape=(np_, np_), dtype=value)
        c2 = wp.zeros(shape=(np_, np_), dtype=value)
        f1 = wp.zeros(shape=(np_, np_), dtype=value)
        f2 = wp.zeros(shape=(np_, np_), dtype=value)
        div = wp.zeros(shape=(np_, np_), dtype=value)
        curl = wp.zeros(shape=(np_, np_), dtype=value)
        for i in range(np_):
            for j in range(np_):
                n = i * np_ + j
                node = geo.nodes[e, n]
                u = laws.diffused(geo, 0, node, load(x, 0, node))
                v = laws.diffused(geo, geo.size, node, load(x, geo.size, node))
                c1[i, j] = dot(geo.basis[e, n, 0], geo.basis[e, n, 1], u, v)
                c2[i, j] = dot(geo.basis[e, n, 2], geo.basis[e, n, 3], u, v)
                f1[i, j] = wedge(u, v, geo.basis[e, n, 2], geo.basis[e, n, 3])
                f2[i, j] = wedge(geo.basis[e, n, 0], geo.basis[e, n, 1], u, v)
        for i in range(np_):
            for j in range(np_):
                d = geo.derivative
                w = geo.weight[i, j] * geo.inverse_jacobian[e, i * np_ + j]
                div[i, j] = mul(w, d1(d, f1, i, j) + d2(d, f2, i, j))
                curl[i, j] = mul(w, d1(d, c2, i, j) - d2(d, c1, i, j))
        for i in range(np_):
            for j in range(np_):
                n = i * np_ + j
                d = geo.derivative
                a11 = geo.basis[e, n, 0]
                a12 = geo.basis[e, n, 1]
                a21 = geo.basis[e, n, 2]
                a22 = geo.basis[e, n, 3]
                p1 = t1(d, div, i, j)
                p2 = t2(d, div, i, j)
                q1 = t1(d, curl, i, j)
                q2 = t2(d, curl, i, j)
                ru = -wedge(p1, p2, a12, a22) - wedge(q1, q2, a11, a21)
                rv = -wedge(a11, a21, p1, p2) - wedge(q1, q2, a12, a22)
                if wp.static(adds):
                    ru += out[e, n, 0]
                    rv += out[e, n, 1]
                out[e, n, 0] = ru
                out[e, n, 1] = rv

    return diffusion


def _diffusion_of_height(
    t: SimpleNamespace, ops: SimpleNamespace, laws: SimpleNamespace, line: SimpleNamespace
) -> wp.Function:
    """Weak Laplacian of the surface height, -(grad phi, grad s) for each nodal test function."""
    np_, value, adds, last = t.np, t.value, t.terms.dynamics, t.terms.unknowns - 1
    mul, load, wedge = ops.mul, ops.load, ops.wedge
    d1, d2, t1, t2 = line.d1, line.d2, line.t1, line.t2

    @no_type_check
    @wp.func
    def diffusion(geo: t.geometry, x: t.vector, e: int, out: t.local):
        s = wp.zeros(shape=(np_, np_), dtype=value)
        f1 = wp.zeros(shape=(np_, np_), dtype=value)
        f2 = wp.zeros(shape=(np_, np_), dtype=value)
        for i in range(np_):
            for j in range(np_):
                node = geo.nodes[e, i * np_ + j]
                height = laws.surface(geo, node, load(x, last * geo.size, node))
                s[i, j] = laws.diffused(geo, last * geo.size, node, height)
        for i in range(np_):
            for j in range(np_):
                n = i * np_ + j
                a11 = geo.basis[e, n, 0]
                a12 = geo.basis[e, n, 1]
                a21 = geo.basis[e, n, 2]
                a22 = geo.basis[e, n, 3]
                s1 = d1(geo.derivative, s, i, j)
                s2 = d2(geo.derivative, s, i, j)
                u = wedge(s1, s2, a12, a22)
                v = wedge(a11, a21, s1, s2)
                w = geo.weight[i, j] * geo.inverse_jacobian[e, n]
                f1[i, j] = mul(w, wedge(u, v, a21, a22))
                f2[i, j] = mul(w, wedge(a11, a12, u, v))
        for i in range(np_):
            for j in range(np_):
                n = i * np_ + j
                r = -t1(geo.derivative, f1, i, j) - t2(geo.derivative, f2, i, j)
                if wp.static(adds):
                    r += out[e, n, last]
                out[e, n, last] = r

    return diffusion
