"""Penalty on the jumps of vorticity and divergence at the edges of elements.

With the vorticity and divergence of each element at its edge and their weighted means over the
elements that meet there, the weak form for every test wind w is

    -sum over elements and edge nodes of gamma W J [(zeta - mean) curl w + (delta - mean) div w].

The means are weighted with gamma W J, so that the operator is symmetric and negative semi-definite
also where gamma differs from element to element.  (Burman & Hansbo 2004,
doi:10.1016/j.cma.2003.12.032, penalise the jumps of gradients in this way.)
"""

from swe_sphere.kernels.define import func, vector
from swe_sphere.kernels.formulas import Formula, no_wind, none, pair, winds_at
from swe_sphere.kernels.metric import contravariant_flux, covariant_wind, curl, divergence, gradient
from swe_sphere.kernels.simd.arithmetic import mul
from swe_sphere.kernels.simd.memory import load_nodes
from swe_sphere.kernels.terms import geometry, np_

winds, wind = winds_at(own=True, base=False)


@func
def _wind_components(geo: geometry, w: winds, a: vector, x: vector, at: int, e: int, n: int):
    r1 = pair()
    r2 = pair()
    f1, f2 = contravariant_flux(geo.basis, e, n, w[0], w[1])
    u1, u2 = covariant_wind(geo.basis, e, n, w[0], w[1])
    r1[0] = f1
    r1[1] = u2
    r2[0] = f2
    r2[1] = u1
    return r1, r2


@func
def _weighted(geo: geometry, w: winds, d1: pair, d2: pair, e: int, n: int):
    weight = geo.weight[n // np_, n % np_] * geo.strength[e, n]
    r = pair()
    r[0] = mul(weight, divergence(d1[0], d2[0]))
    r[1] = mul(weight, curl(d1[1], d2[1]))
    return r


derivatives = Formula(winds, wind, pair, _wind_components, _weighted, 2)
"""gamma W J times divergence and vorticity of the wind x at edges of elements."""


@func
def _jumps(geo: geometry, w: none, a: vector, x: vector, at: int, e: int, n: int):
    node = geo.nodes[e, n]
    weight = geo.weight[n // np_, n % np_] * geo.strength[e, n]
    r = pair()
    for k in range(2):
        mean = load_nodes(x, k * geo.size, node)
        r[k] = mul(geo.inverse_jacobian[e, n], geo.jumps[e, n, k]) - mul(weight, mean)
    return r, r


@func
def _weak(geo: geometry, w: none, d1: pair, d2: pair, e: int, n: int):
    gu, gv = gradient(geo.basis, e, n, d1[0], d2[0])
    cu, cv = gradient(geo.basis, e, n, d1[1], d2[1])
    r = pair()
    r[0] = cv - gu
    r[1] = -gv - cu
    return r


weak_form = Formula(none, no_wind, pair, _jumps, _weak, 2, is_scalar=True)
"""The weak form, of `geometry.jumps` (what the kernel of `derivatives` left) and the means x (2N,).

`geometry.derivative` is the transposed derivative matrix.
"""
