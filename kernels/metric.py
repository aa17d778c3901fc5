"""Vectors on the sphere and their derivatives in the reference coordinates of an element.

With the 2x2 matrix a[i, k] = dx/dxi_i . e_k [m] (frame e_k, reference coordinates xi_i) and
J = det a, the covariant wind is u_i = a[i, k] V_k, and J times the contravariant wind as well as J
times a gradient need only the adjugate of a, so that no division is needed (formulas: Taylor &
Fournier 2010, doi:10.1016/j.jcp.2010.04.008, section 4).
"""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from swe_sphere.kernels.define import func
from swe_sphere.kernels.simd.arithmetic import product_of
from swe_sphere.kernels.simd.register import Register


@dataclass(frozen=True)
class Metric:
    """Device functions at node n of element e, for plain numbers or for SIMD registers.

    `basis` (groups, np*np, 4) holds a[1, 1], a[1, 2], a[2, 1] and a[2, 2] [m]; d1 and d2 are
    derivatives along the reference coordinates.
    """

    mul: Any
    """(p, q): the product."""
    dot: Any
    """(p, q, u, v): p u + q v."""
    contravariant_flux: Any
    """(basis, e, n, u, v): J times the contravariant components of the vector (u, v)."""
    covariant_wind: Any
    """(basis, e, n, u, v): the covariant components of the vector (u, v)."""
    gradient: Any
    """(basis, e, n, d1, d2): J times the gradient of a field with these derivatives."""
    divergence: Any
    """(d1, d2): J times the divergence, of the contravariant flux: d1 of its first component along
    the first coordinate, d2 of the second along the second."""
    curl: Any
    """(d1, d2): J times the vorticity, of the covariant wind: d1 of its second component along the
    first coordinate, d2 of the first along the second."""
    area: Any
    """(basis, e, n): J [m2]."""


@functools.cache
def metric_of(register: Register, whole: bool = True) -> Metric:
    """Return the functions for a register.

    whole: products are those of whole registers.  Products of numbers that were gathered lane by
    lane take half as long again with them.
    """
    value, basis = register.value, wp.array3d(dtype=register.value)
    mul: Any = product_of(register) if whole or register.lanes == 1 else wp.cw_mul

    @func
    def dot(p: value, q: value, u: value, v: value):
        return mul(p, u) + mul(q, v)

    @func
    def wedge(p: value, q: value, u: value, v: value):
        return mul(p, v) - mul(q, u)

    @func
    def contravariant_flux(b: basis, e: int, n: int, u: value, v: value):
        return wedge(u, v, b[e, n, 2], b[e, n, 3]), wedge(b[e, n, 0], b[e, n, 1], u, v)

    @func
    def covariant_wind(b: basis, e: int, n: int, u: value, v: value):
        return dot(b[e, n, 0], b[e, n, 1], u, v), dot(b[e, n, 2], b[e, n, 3], u, v)

    @func
    def gradient(b: basis, e: int, n: int, d1: value, d2: value):
        return wedge(d1, d2, b[e, n, 1], b[e, n, 3]), wedge(b[e, n, 0], b[e, n, 2], d1, d2)

    @func
    def divergence(d1: value, d2: value):
        return d1 + d2

    @func
    def curl(d1: value, d2: value):
        return d1 - d2

    @func
    def area(b: basis, e: int, n: int):
        return wedge(b[e, n, 0], b[e, n, 1], b[e, n, 2], b[e, n, 3])

    return Metric(mul, dot, contravariant_flux, covariant_wind, gradient, divergence, curl, area)
