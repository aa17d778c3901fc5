"""Vectors on the sphere and their derivatives in the reference coordinates of an element.

With the 2x2 matrix a[i, k] = dx/dxi_i . e_k [m] (e_1 east, e_2 north, reference coordinates xi_i)
and J = det a, the covariant wind is u_i = a[i, k] V_k. J times the contravariant wind and J times a
gradient require only the adjugate of a, hence no division (formulas: Taylor & Fournier 2010,
doi:10.1016/j.jcp.2010.04.008, section 4).

The functions apply to node n of element e, with plain numbers or SIMD registers. `basis` (groups,
np*np, 4) holds a[1, 1], a[1, 2], a[2, 1], a[2, 2] [m]; d1, d2: derivatives in the element.
"""

import warp as wp

from swe_sphere.kernels.define import func, value
from swe_sphere.kernels.simd.arithmetic import mul

basis = wp.array3d(dtype=value)


@func
def dot(p: value, q: value, u: value, v: value):
    return mul(p, u) + mul(q, v)


@func
def wedge(p: value, q: value, u: value, v: value):
    return mul(p, v) - mul(q, u)


@func
def contravariant_flux(b: basis, e: int, n: int, u: value, v: value):
    """Return J times the contravariant components of the vector (u, v)."""
    return wedge(u, v, b[e, n, 2], b[e, n, 3]), wedge(b[e, n, 0], b[e, n, 1], u, v)


@func
def covariant_wind(b: basis, e: int, n: int, u: value, v: value):
    """Return the covariant components of the vector (u, v)."""
    return dot(b[e, n, 0], b[e, n, 1], u, v), dot(b[e, n, 2], b[e, n, 3], u, v)


@func
def gradient(b: basis, e: int, n: int, d1: value, d2: value):
    """Return J times the gradient of a field with the derivatives d1 and d2."""
    return wedge(d1, d2, b[e, n, 1], b[e, n, 3]), wedge(b[e, n, 0], b[e, n, 2], d1, d2)


@func
def divergence(d1: value, d2: value):
    """Return J div from d1 of the first contravariant flux and d2 of the second."""
    return d1 + d2


@func
def curl(d1: value, d2: value):
    """Return J times the vorticity from d1 of the second covariant wind and d2 of the first."""
    return d1 - d2


@func
def jacobian(b: basis, e: int, n: int):
    """Return J, the area element [m2]."""
    return wedge(b[e, n, 0], b[e, n, 1], b[e, n, 2], b[e, n, 3])
