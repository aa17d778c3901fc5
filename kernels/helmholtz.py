"""Block elimination of the linearised equations, on fields that each element stores separately.

With tau the implicit step, T = (I + tau f k x)^-1 and the depth H, elimination of the wind leads to
S = I - tau^2 g D H T G for the depth, with the assembled discrete gradient G and divergence D.

A field (groups + 1, np*np, 1) stores a shared node once in each of its elements, so that kernels
read whole SIMD registers. Local results before DSS have the same shape, and the next kernel that
reads them applies DSS: it adds to an element's own contribution those at `runs` (groups, np*np,
3), one on an edge of the element and three at a corner. A missing contributor points to the group
behind the elements, which is zero.

Kernels with a `geometry` require `Terms.waves`. They run over `KernelTypes.threads` of groups: each
handles the nodes n of an element, by rows i, or one node. Rows are unrolled, since arithmetic for
indices would take a fifth of the time. Kernels that write a vector of nodes run over these. Threads
of whole elements store all fluxes in one row of f1 and f2, which stays in the nearest cache, and
then compute their divergence; for threads of single nodes the kernel `divergence` does.
"""

import functools
from typing import Any

import warp as wp

from swe_sphere.kernels.define import func, kernel, lanes, real, unrolled, value, vector
from swe_sphere.kernels.metric import divergence as div
from swe_sphere.kernels.metric import dot
from swe_sphere.kernels.metric import gradient as grad
from swe_sphere.kernels.simd import memory
from swe_sphere.kernels.simd.arithmetic import mul
from swe_sphere.kernels.simd.memory import address, gather, load, load_given, load_runs, nodes, pick
from swe_sphere.kernels.terms import across, along, geometry, local, lone, np_, side, state_vector


@func
def assemble(geo: geometry, field: local, flat: vector, e: int, i: int, n: int):
    """Return the sum over the contributors of an element's node, not divided by the nodal area."""
    total = field[e, n, 0]
    j = n - i * np_
    on_1 = i == 0 or i == np_ - 1
    on_2 = j == 0 or j == np_ - 1
    if on_1 or on_2:
        total += load_runs(flat, geo.runs[e, n, 0], geo.others)
    if on_1 and on_2:
        second = load_runs(flat, geo.runs[e, n, 1], geo.others)
        total += second + load_runs(flat, geo.runs[e, n, 2], geo.others)
    return total


@func
def derivatives(geo: geometry, a: local, b: local, e: int, i: int, n: int):
    """Return the derivatives of a along the first coordinate and of b along the second."""
    at = e * np_ * np_
    on_1 = wp.array(ptr=address(a, at), shape=(np_, np_), dtype=value)
    on_2 = wp.array(ptr=address(b, at), shape=(np_, np_), dtype=value)
    j = n - i * np_
    return along(geo.derivative, on_1, i, j), across(geo.derivative, on_2, i, j)


@unrolled
def gradient(begin: int, geo: geometry, x: local, east: local, north: local):
    """Store the weighted gradient of x before DSS."""
    e, p, q = wp.tid()
    e += begin
    for i in range(p * side, p * side + side):
        for k in range(side):
            n = i * np_ + lone * q + k
            w = geo.weight[i, n - i * np_]
            s1, s2 = derivatives(geo, x, x, e, i, n)
            g1, g2 = grad(geo.basis, e, n, s1, s2)
            east[e, n, 0] = w * g1
            north[e, n, 0] = w * g2


@func
def diverge(geo: geometry, f1: local, f2: local, row: int, e: int, p: int, q: int, out: local):
    """Store the weighted divergence of the fluxes in a row of f1 and f2 before DSS."""
    for i in range(p * side, p * side + side):
        for k in range(side):
            n = i * np_ + lone * q + k
            s1, s2 = derivatives(geo, f1, f2, row, i, n)
            out[e, n, 0] = geo.weight[i, n - i * np_] * div(s1, s2)


@unrolled
def divergence(begin: int, geo: geometry, f1: local, f2: local, out: local):
    """Store the weighted divergence of two fluxes before DSS."""
    e, p, q = wp.tid()
    diverge(geo, f1, f2, begin + e, begin + e, p, q, out)


@func
def put_fluxes(geo: geometry, u: value, v: value, row: int, e: int, n: int, f1: local, f2: local):
    f1[row, n, 0] = dot(geo.flux_matrix[e, n, 0], geo.flux_matrix[e, n, 1], u, v)
    f2[row, n, 0] = dot(geo.flux_matrix[e, n, 2], geo.flux_matrix[e, n, 3], u, v)


@unrolled
def wind_fluxes(begin: int, geo: geometry, r: state_vector, f1: local, f2: local, out: local):
    """Store the fluxes H T V of the wind V of r and, by elements, their divergence in `out`."""
    e, p, q = wp.tid()
    e += begin
    row = lone * e
    for i in range(p * side, p * side + side):
        for k in range(side):
            n = i * np_ + lone * q + k
            u = load_given(r, 0, geo.nodes[e, n])
            v = load_given(r, geo.size, geo.nodes[e, n])
            put_fluxes(geo, u, v, row, e, n, f1, f2)
    if wp.static(lone == 0):
        diverge(geo, f1, f2, row, e, p, q, out)


@unrolled
def slope_fluxes(
    begin: int, geo: geometry, east: local, east_flat: vector, north: local, north_flat: vector,
    f1: local, f2: local, out: local,
):  # fmt: skip
    """Store the fluxes H T V of a gradient V and, by elements, their divergence in `out`."""
    e, p, q = wp.tid()
    e += begin
    row = lone * e
    for i in range(p * side, p * side + side):
        for k in range(side):
            n = i * np_ + lone * q + k
            u = mul(geo.per_area[e, n], assemble(geo, east, east_flat, e, i, n))
            v = mul(geo.per_area[e, n], assemble(geo, north, north_flat, e, i, n))
            put_fluxes(geo, u, v, row, e, n, f1, f2)
    if wp.static(lone == 0):
        diverge(geo, f1, f2, row, e, p, q, out)


@unrolled
def eliminate(
    begin: int, geo: geometry, field: local, flat: vector, r: state_vector, tau: real, b: local
):
    """Set b = r_h - tau D H T r_V; `field` is the weighted divergence before DSS."""
    e, p, q = wp.tid()
    e += begin
    for i in range(p * side, p * side + side):
        for k in range(side):
            n = i * np_ + lone * q + k
            outflow = mul(geo.per_area[e, n], assemble(geo, field, flat, e, i, n))
            b[e, n, 0] = load_given(r, 2 * geo.size, geo.nodes[e, n]) - tau * outflow


@func
def image(
    geo: geometry, field: local, flat: vector, tau_tau_g: real, d: local, e: int, i: int, n: int
):
    """Return S d, with `field` = D H T G d before DSS."""
    return d[e, n, 0] - tau_tau_g * mul(geo.per_area[e, n], assemble(geo, field, flat, e, i, n))


@unrolled
def product(
    begin: int, geo: geometry, field: local, flat: vector, tau_tau_g: real, d: local, share_b: real,
    b: local, sign: real, out: local,
):  # fmt: skip
    """Set out = share_b b + sign S d, with `field` = D H T G d before DSS."""
    e, p, q = wp.tid()
    e += begin
    for i in range(p * side, p * side + side):
        for k in range(side):
            n = i * np_ + lone * q + k
            found = image(geo, field, flat, tau_tau_g, d, e, i, n)
            out[e, n, 0] = share_b * b[e, n, 0] + sign * found


@unrolled
def chebyshev_start(begin: int, geo: geometry, size: real, b: local, x: local):
    """Take the first Chebyshev step from zero: x = size b / diag(S)."""
    e, p, q = wp.tid()
    e += begin
    for i in range(p * side, p * side + side):
        for k in range(side):
            n = i * np_ + lone * q + k
            x[e, n, 0] = size * mul(geo.per_diagonal[e, n], b[e, n, 0])


@unrolled
def chebyshev_step(
    begin: int, geo: geometry, field: local, flat: vector, tau_tau_g: real, size: real, b: local,
    x: local,
):  # fmt: skip
    """Set x += size (b - S x) / diag(S), with `field` = D H T G x before DSS."""
    e, p, q = wp.tid()
    e += begin
    for i in range(p * side, p * side + side):
        for k in range(side):
            n = i * np_ + lone * q + k
            residual = b[e, n, 0] - image(geo, field, flat, tau_tau_g, x, e, i, n)
            x[e, n, 0] = x[e, n, 0] + size * mul(geo.per_diagonal[e, n], residual)


@functools.cache
def substitute_kernel(given: Any) -> Any:
    """Return the kernel that stores the wind that follows from the depth, and the depth.

    The states r and `out` (3N,) have the number type `given`.
    """
    load_as, put_as = memory.converting(given)
    state_vector = wp.array(dtype=given)

    @kernel
    def substitute(
        begin: int, places: memory.Places, first_copies: memory.Numbers, inverse_area: vector,
        same: vector, cross: vector, size: int, east: vector, north: vector, h: vector,
        r: state_vector, tau_g: real, out: state_vector,
    ):  # fmt: skip
        node = begin + lanes * wp.tid()
        scale = tau_g * load(inverse_area, node)
        u = load_as(r, node) - mul(scale, gather(east, places, node, 0))
        v = load_as(r, size + node) - mul(scale, gather(north, places, node, 0))
        s = load(same, node)
        c = load(cross, node)
        put_as(out, node, mul(s, u) + mul(c, v))
        put_as(out, size + node, mul(s, v) - mul(c, u))
        put_as(out, 2 * size + node, pick(h, first_copies, node))

    return substitute


@unrolled
def to_field(begin: int, node: nodes, x: state_vector, out: local):
    """Copy a nodal vector (N,) to a field."""
    e, p, q = wp.tid()
    e += begin
    for i in range(p * side, p * side + side):
        for k in range(side):
            n = i * np_ + lone * q + k
            out[e, n, 0] = load_given(x, 0, node[e, n])


@functools.cache
def to_nodes_kernel(given: Any) -> Any:
    """Return the kernel that copies a field to a nodal vector (N,) of the number type `given`."""
    put_picked, state_vector = memory.picking(given), wp.array(dtype=given)

    @kernel
    def to_nodes(begin: int, first_copies: memory.Numbers, flat: vector, out: state_vector):
        put_picked(flat, first_copies, begin + lanes * wp.tid(), out)

    return to_nodes
