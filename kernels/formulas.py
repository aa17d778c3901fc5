"""Operators on elements, each defined by its formula at a point for both launch shapes.

The launch shapes call these functions with plain numbers (one thread per node) or with SIMD
registers that hold one node of several elements (one thread per group of elements).
"""

from dataclasses import dataclass
from typing import Any

import warp as wp

from swe_sphere.kernels.define import func, rows, value, vector
from swe_sphere.kernels.simd.memory import load_nodes
from swe_sphere.kernels.terms import geometry


@dataclass(frozen=True)
class Formula:
    """An operator at node n of element e; `element.py` and `node.py` add the derivatives.

    x is the vector of the unknowns, with the operator's field at the offset `at`; a is the vector
    of a prescribed wind or of the state from which linear terms take their coefficients.
    """

    winds: Any
    """Type of the winds at a node: rows of winds, or one row of zeros if the formula needs none."""
    load_winds: Any
    """Function (geometry, a, x, e, n) that returns the `winds`."""
    rows: Any
    """Type of the rows that are differentiated."""
    operands: Any
    """Function (geometry, winds, a, x, at, e, n) that returns the two `rows` to differentiate along
    the first and along the second coordinate."""
    result: Any
    """Function (geometry, winds, d1, d2, e, n): `fields` rows of the result times the weights."""
    fields: int
    is_scalar: bool = False
    """True if the same rows are differentiated along both coordinates."""
    needs_winds: bool = False
    """True if the result needs the winds."""
    shares_winds: bool = False
    """True if the winds are loaded once for all fields of a kernel, which pays off for several."""
    edges_only: bool = False
    """True if only results at the edges of elements are used."""
    fluxes: Any = None
    """Function (geometry, d1, d2, e, n) of a weak Laplacian that returns two `rows` for the
    transposed derivatives along each coordinate; see `diffusion` for its result."""


single, pair = rows(1), rows(2)


def winds_at(own: bool, base: bool) -> tuple[Any, Any]:
    """Return `winds` and `load_winds` of a formula: two rows of x if `own`, two of a if `base`."""
    winds, first = rows(max(1, 2 * (own + base))), 2 * own

    @func
    def load_winds(geo: geometry, a: vector, x: vector, e: int, n: int):
        w = winds()
        node = geo.nodes[e, n]
        if wp.static(own):
            w[0] = load_nodes(x, 0, node)
            w[1] = load_nodes(x, geo.size, node)
        if wp.static(base):
            w[first] = load_nodes(a, 0, node)
            w[first + 1] = load_nodes(a, geo.size, node)
        return w

    return winds, load_winds


none, no_wind = winds_at(own=False, base=False)


@func
def row(v: value):
    """Return the rows that hold the register v alone."""
    r = single()
    r[0] = v
    return r


@func
def two_rows(u: value, v: value):
    """Return the rows that hold the registers u and v."""
    r = pair()
    r[0] = u
    r[1] = v
    return r
