"""What an operator on elements is made of at a point, for both launch shapes.

They call the functions here with plain numbers (one thread a node) or with SIMD registers that hold
one node of several elements (one thread a group of elements).

With the 2x2 matrix a[i, k] = dx/dxi_i . e_k (frame e_k, reference coordinates xi_i) and J = det a,
the covariant wind is u_i = a[i, k] V_k, and J times the contravariant wind as well as J times a
gradient need only the adjugate of a, so that no division is needed (formulas: Taylor & Fournier
2010, doi:10.1016/j.jcp.2010.04.008, section 4).
"""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from swe_sphere.kernels.access import lanes_access
from swe_sphere.kernels.registers import product_of


@dataclass(frozen=True)
class Formula:
    """An operator at node n of element e; `element.py` and `node.py` differentiate for it.

    x is the vector of the unknowns, with the field in question at the offset `at`; a is that of a
    prescribed wind or of the state that a tangent is taken at.
    """

    winds: type
    wind: wp.Function
    """(geometry, a, x, e, n): the `winds` there."""
    rows: type
    first: wp.Function
    """(geometry, point, e, n): the `rows` to be differentiated along the first coordinate."""
    second: wp.Function
    """The same along the second; `first` itself where it makes no difference."""
    read: wp.Function
    """(geometry, winds, a, x, at, e, n): the point, what the derivatives are taken of."""
    result: wp.Function | None = None
    """(geometry, winds, d1, d2, e, n): a value, or `fields` rows of them, times the weights."""
    fields: int = 0
    turns: bool = False
    """Whether the result needs the winds."""
    stored: bool = False
    """Whether it is cheaper to store the winds of an element than to load them again."""


def algebra(value: type, index: type, real: type, lanes: int, whole: bool) -> SimpleNamespace:
    """Loads and products for the number type `value`: a scalar (`lanes` 1) or a vector of lanes.

    whole: products of whole registers; not of what was gathered lane by lane, which takes half as
    long again with them.
    """
    mul: Any = wp.mul
    if lanes > 1:
        mul = product_of(value, real, lanes) if whole else wp.cw_mul

    @no_type_check
    @wp.func
    def load(x: wp.array(dtype=real), offset: int, node: index):
        return x[offset + node]

    load_run = None
    if lanes > 1:
        load, load_run = lanes_access(value, index, real, lanes)

    @no_type_check
    @wp.func
    def dot(p: value, q: value, u: value, v: value):
        return mul(p, u) + mul(q, v)

    @no_type_check
    @wp.func
    def wedge(p: value, q: value, u: value, v: value):
        return mul(p, v) - mul(q, u)

    return SimpleNamespace(mul=mul, load=load, load_run=load_run, dot=dot, wedge=wedge)


def keep_fields(t: SimpleNamespace, f: Formula) -> wp.Function:
    """Function (result, e, n, k, out): its fields in `out`, from the k-th on."""

    @no_type_check
    @wp.func
    def keep(r: t.rows(f.fields), e: int, n: int, k: int, out: t.local):
        if wp.static(f.fields == 1):
            out[e, n, k] = r
        else:
            out[e, n, k] = r[0]
            out[e, n, k + 1] = r[1]
            if wp.static(f.fields == 3):
                out[e, n, k + 2] = r[2]

    return keep


def winds_at(t: SimpleNamespace, own: bool, base: bool) -> tuple[type, wp.Function]:
    """`winds` and `wind` of a formula: (u, v) of x if `own`, (bu, bv) of a if `base`."""
    real, load, vector = t.real, t.ops.load, t.vector
    winds = t.struct("Winds", own * ["u", "v"] + base * ["bu", "bv"]) if own or base else real

    @no_type_check
    @wp.func
    def wind(geo: t.geometry, a: vector, x: vector, e: int, n: int):
        if wp.static(not (own or base)):
            return real(0.0)
        else:
            r = winds()
            node = geo.nodes[e, n]
            if wp.static(own):
                r.u = load(x, 0, node)
                r.v = load(x, geo.size, node)
            if wp.static(base):
                r.bu = load(a, 0, node)
                r.bv = load(a, geo.size, node)
            return r

    return winds, wind


def slopes(
    t: SimpleNamespace, scalar: bool = False, flux: bool = False, curls: int = 0
) -> tuple[type, type, wp.Function, wp.Function]:
    """Type of the point, and `rows`, `first` and `second` of a formula.

    Of a scalar s both derivatives are taken, of J times the contravariant components of the flux
    (fu, fv) those of the divergence, of the covariant winds (u, v) and (bu, bv) those of the curl:
    the first derivative less the second.  A row that is alone is no row but a value.
    """
    pairs = [["fu", "fv"]] * flux + [["u", "v"], ["bu", "bv"]][:curls]
    point = t.struct("Point", ["s"] * scalar + [name for pair in pairs for name in pair])
    count = scalar + len(pairs)
    rows, at_curl, dot, wedge = t.rows(count), scalar + flux, t.ops.dot, t.ops.wedge

    @no_type_check
    @wp.func
    def first(geo: t.geometry, p: point, e: int, n: int):
        if wp.static(count == 1 and scalar):
            return p.s
        elif wp.static(count == 1):
            return wedge(p.fu, p.fv, geo.basis[e, n, 2], geo.basis[e, n, 3])
        else:
            r = rows()
            if wp.static(scalar):
                r[0] = p.s
            if wp.static(flux):
                r[at_curl - 1] = wedge(p.fu, p.fv, geo.basis[e, n, 2], geo.basis[e, n, 3])
            if wp.static(curls > 0):
                r[at_curl] = dot(geo.basis[e, n, 2], geo.basis[e, n, 3], p.u, p.v)
            if wp.static(curls > 1):
                r[at_curl + 1] = dot(geo.basis[e, n, 2], geo.basis[e, n, 3], p.bu, p.bv)
            return r

    @no_type_check
    @wp.func
    def second(geo: t.geometry, p: point, e: int, n: int):
        if wp.static(count == 1):
            return wedge(geo.basis[e, n, 0], geo.basis[e, n, 1], p.fu, p.fv)
        else:
            r = rows()
            if wp.static(scalar):
                r[0] = p.s
            if wp.static(flux):
                r[at_curl - 1] = wedge(geo.basis[e, n, 0], geo.basis[e, n, 1], p.fu, p.fv)
            if wp.static(curls > 0):
                r[at_curl] = dot(geo.basis[e, n, 0], geo.basis[e, n, 1], p.u, p.v)
            if wp.static(curls > 1):
                r[at_curl + 1] = dot(geo.basis[e, n, 0], geo.basis[e, n, 1], p.bu, p.bv)
            return r

    return point, rows, first, second if pairs else first
