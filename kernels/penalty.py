"""Penalty on the jumps of vorticity and divergence at the edges of elements.

With the vorticity and divergence of each element at its edge and their weighted means over the
elements that meet there, the weak form for every test wind w is

    -sum over elements and edge nodes of gamma W J [(zeta - mean) curl w + (delta - mean) div w].

The means are weighted with gamma W J, so that the operator is symmetric and negative semi-definite
also where gamma differs from element to element.  (Burman & Hansbo 2004,
doi:10.1016/j.cma.2003.12.032, penalise the jumps of gradients in this way.)
"""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from swe_sphere.kernels.define import func
from swe_sphere.kernels.element import element_kernel
from swe_sphere.kernels.formulas import Formula, winds_at
from swe_sphere.kernels.node import node_kernel
from swe_sphere.kernels.terms import KernelTypes, Terms


@dataclass(frozen=True)
class PenaltyKernels:
    """Kernels of the penalty, with the arguments of `FieldKernels`."""

    derivatives: wp.Kernel
    """gamma W J times divergence and vorticity of the wind x at edges of elements, to `out`."""
    penalty: wp.Kernel
    """The weak form, of `geometry.jumps` (what `derivatives` left) and the means x (2N,).

    `geometry.derivative` is the transposed derivative matrix.
    """
    geometry: Any
    value: Any


@functools.cache
def penalty_kernels(np_: int, real: Any, shape: str) -> PenaltyKernels:
    """Return the kernels for winds of `real`."""
    t = KernelTypes(np_, real, shape, Terms(jumps=True))
    made: Any = element_kernel if shape == "element" else node_kernel
    return PenaltyKernels(made(t, _derivatives(t)), made(t, _weak_form(t)), t.geometry, t.value)


def _derivatives(t: KernelTypes) -> Formula:
    """Return the formula of gamma W J times divergence and vorticity."""
    np_, metric = t.np, t.metric
    mul, flux, covariant = metric.mul, metric.contravariant_flux, metric.covariant_wind
    divergence, curl = metric.divergence, metric.curl
    winds, wind = winds_at(t, own=True, base=False)
    rows = t.register.rows(2)

    @func
    def slopes(geo: t.geometry, w: winds, a: t.vector, x: t.vector, at: int, e: int, n: int):
        r1 = rows()
        r2 = rows()
        f1, f2 = flux(geo.basis, e, n, w[0], w[1])
        u1, u2 = covariant(geo.basis, e, n, w[0], w[1])
        r1[0] = f1
        r1[1] = u2
        r2[0] = f2
        r2[1] = u1
        return r1, r2

    @func
    def result(geo: t.geometry, w: winds, d1: rows, d2: rows, e: int, n: int):
        weight = geo.weight[n // np_, n % np_] * geo.strength[e, n]
        r = rows()
        r[0] = mul(weight, divergence(d1[0], d2[0]))
        r[1] = mul(weight, curl(d1[1], d2[1]))
        return r

    return Formula(winds, wind, rows, slopes, result, 2)


def _weak_form(t: KernelTypes) -> Formula:
    """Return the formula of the weak form, which differentiates with the transposed matrix."""
    np_, metric, load = t.np, t.metric, t.load
    mul, grad = metric.mul, metric.gradient
    winds, wind = winds_at(t, own=False, base=False)
    rows = t.register.rows(2)

    @func
    def slopes(geo: t.geometry, w: winds, a: t.vector, x: t.vector, at: int, e: int, n: int):
        node = geo.nodes[e, n]
        weight = geo.weight[n // np_, n % np_] * geo.strength[e, n]
        r = rows()
        for k in range(2):
            mean = load(x, k * geo.size, node)
            r[k] = mul(geo.inverse_jacobian[e, n], geo.jumps[e, n, k]) - mul(weight, mean)
        return r, r

    @func
    def result(geo: t.geometry, w: winds, d1: rows, d2: rows, e: int, n: int):
        gu, gv = grad(geo.basis, e, n, d1[0], d2[0])
        cu, cv = grad(geo.basis, e, n, d1[1], d2[1])
        r = rows()
        r[0] = cv - gu
        r[1] = -gv - cu
        return r

    return Formula(winds, wind, rows, slopes, result, 2, is_scalar=True)
